"""A file system of a few megabytes, where the tests may mount one."""

import contextlib
import os
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest


class SmallDisk:
    """A tmpfs at ``path``."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def resize(self, **options: object) -> None:
        """``size`` in bytes, ``nr_inodes`` files; 0 for any number."""
        words = ",".join(["remount", *(f"{name}={value}" for name, value in options.items())])
        subprocess.run(["mount", "-o", words, str(self.path)], check=True)

    def fill(self, free: int) -> Path:
        """A file that leaves about so many bytes free."""
        filler = self.path / "filler"
        found = os.statvfs(self.path)
        with open(filler, "wb") as file:
            file.write(b"\1" * max(0, found.f_bavail * found.f_frsize - free))
        return filler


@contextlib.contextmanager
def small_disk(path: Path, size: int) -> Iterator[SmallDisk]:
    """Mounted at ``path`` with ``size`` bytes; the test is skipped where that is not allowed."""
    path.mkdir()
    try:
        done = subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", str(path)], capture_output=True, text=True)
    except FileNotFoundError:
        pytest.skip("needs a small disk: there is no mount command here")
    if done.returncode:
        pytest.skip(f"needs a small disk, and may not mount a tmpfs here: {done.stderr.strip()}")
    try:
        yield SmallDisk(path)
    finally:
        subprocess.run(["umount", "--lazy", str(path)], check=True)
