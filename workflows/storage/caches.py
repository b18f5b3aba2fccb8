"""What is kept in a workspace only to save time, and is made again when it is missed: unpacked archives, and what was heard of videos."""

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

_ABANDONED = 86400.0  # s; half a folder without a mark, or half a file, may have been begun just now
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
    """All that were last used so many seconds ago, those first that were used longest ago; what died while it was made is among them."""
    places = [path for folder in ("heard", "unpacked") for path in (workspace / folder).glob("*")]
    now = time.time()
    found = [item for path in places if (item := _item(path)) is not None]
    usual = [item for item in found if now - item.used >= (max(older_than, _ABANDONED) if _half(item.path) else older_than)]
    return sorted(usual, key=lambda item: item.used)


def remove(item: Kept) -> bool:
    """False where a process uses it, or has used it since. A file may be removed at any time: who has it open reads on, and who misses it
    makes it again."""
    if item.path.parent.name == "heard":
        item.path.unlink(missing_ok=True)
        return True
    try:
        with alone(mark_of(item.path)) as free:
            now = _item(item.path)
            if not free or (now is not None and now.used > item.used):
                return False
            gone = Path(tempfile.mkdtemp(prefix=_GONE, dir=item.path.parent))  # in one step: a crash leaves no half of it under its name
            with suppress(FileNotFoundError):
                os.rename(item.path, gone / item.path.name)
    except OSError:
        return False  # it cannot be locked, or belongs to somebody else
    shutil.rmtree(gone, ignore_errors=True)
    return True


def _item(path: Path) -> Kept | None:
    """None where it went away meanwhile."""
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
    """Whether it may be the work of a process that lives and cannot be told from a dead one's."""
    return path.name.startswith(".") and not path.name.startswith(_GONE) and not mark_of(path).exists()
