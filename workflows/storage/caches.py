"""The caches of a workspace, which only save time and are rebuilt when missing: unpacked archives, and sound onsets of long videos."""

from __future__ import annotations

import os
import shutil
import tempfile
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from ...pipeline.files import sizes
from ...pipeline.storage.hold import alone
from .archive import mark_of

_ABANDONED = 86400.0  # s; an incomplete file, or folder without a mark, that is younger may still be in the making
_GONE = ".gone-"


@dataclass(frozen=True)
class Kept:
    """A file of ``heard/`` or a folder of ``unpacked/``. used: seconds since 1970."""

    path: Path
    size: int
    used: float

    @property
    def name(self) -> str:
        return f"{self.path.parent.name}/{self.path.name}"


def kept(workspace: Path, older_than: float = 0.0) -> list[Kept]:
    """Items last used at least ``older_than`` seconds ago, the least recently used first, including those that a crash left incomplete."""
    places = [path for folder in ("heard", "unpacked") for path in (workspace / folder).glob("*")]
    now = time.time()
    found = [item for path in places if (item := _item(path)) is not None]
    usual = [item for item in found if now - item.used >= (max(older_than, _ABANDONED) if _half(item.path) else older_than)]
    return sorted(usual, key=lambda item: item.used)


def remove(item: Kept) -> bool:
    """Removes an item; False if a process uses it or has used it since. A file can be removed at any time: a process that has it open keeps
    reading, and one that misses it makes it again."""
    if item.path.parent.name == "heard":
        item.path.unlink(missing_ok=True)
        return True
    try:
        with alone(mark_of(item.path)) as free:
            now = _item(item.path)
            if not free or (now is not None and now.used > item.used):
                return False
            gone = Path(tempfile.mkdtemp(prefix=_GONE, dir=item.path.parent))  # renamed first: a crash leaves no half under its own name
            with suppress(FileNotFoundError):
                os.rename(item.path, gone / item.path.name)
    except OSError:
        return False  # it cannot be locked, or belongs to another user
    shutil.rmtree(gone, ignore_errors=True)
    return True


def _item(path: Path) -> Kept | None:
    """The item at a path; None if it has been removed in the meantime."""
    try:
        if not path.is_dir():
            found = path.stat()
            return Kept(path, found.st_size, found.st_mtime)
        mark = mark_of(path)
        used = (mark if mark.exists() else path).stat().st_mtime
        return Kept(path, sum(max(0, size) for size in sizes(path).values()), used)
    except OSError:
        return None


def _half(path: Path) -> bool:
    """Whether the item is incomplete, and may belong either to a running process or to a dead one."""
    return path.name.startswith(".") and not path.name.startswith(_GONE) and not mark_of(path).exists()
