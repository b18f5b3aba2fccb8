"""Who uses an artifact holds it: a shared lock on its manifest, which the system frees when the user dies.

It works on read-only file systems and needs no files of its own. Who wants to remove an artifact takes the same lock alone, see `alone`.
"""

from __future__ import annotations

import fcntl
import os
import weakref
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

Mark = tuple[int, int]  # device and inode of the manifest


def hold(owner: object, manifest: Path) -> tuple[bytes, Mark]:
    """The content of a manifest, which is held from now on until ``owner`` is no more. Raises OSError, FileNotFoundError above all.

    Where the file system knows no locks the content is read all the same: nobody can remove anything there (`alone` raises).
    """
    while True:
        descriptor = os.open(manifest, os.O_RDONLY | os.O_CLOEXEC)
        try:
            with suppress(OSError):
                fcntl.flock(descriptor, fcntl.LOCK_SH)
            mark = _mark(os.fstat(descriptor))
            if is_held_at(mark, manifest):  # else it was taken away between the two calls
                content = _read(descriptor)
                weakref.finalize(owner, os.close, descriptor)
                descriptor = -1
                return content, mark
        finally:
            if descriptor >= 0:
                os.close(descriptor)


def is_held_at(mark: Mark, manifest: Path) -> bool:
    """Whether the manifest that was held lies there still."""
    try:
        return _mark(os.stat(manifest)) == mark
    except FileNotFoundError:
        return False


@contextmanager
def alone(manifest: Path) -> Iterator[bool]:
    """True while no other holds the artifact, and none can begin to; False at once where one does. Nobody holds what has no manifest.

    Raises OSError where it cannot be locked.
    """
    try:
        descriptor = os.open(manifest, os.O_RDWR | os.O_CLOEXEC)  # network file systems lock alone only what is open for writing
    except FileNotFoundError:
        yield True
        return
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            yield False
            return
        yield True
    finally:
        os.close(descriptor)


def _mark(found: os.stat_result) -> Mark:
    return found.st_dev, found.st_ino


def _read(descriptor: int) -> bytes:
    parts = []
    while part := os.read(descriptor, 1 << 20):
        parts.append(part)
    return b"".join(parts)
