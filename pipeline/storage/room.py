"""Reports a full disk in one message: which file, how much has been written, and how much is free."""

from __future__ import annotations

import errno
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from ..errors import StageError
from ..files import bytes_in

_FULL = {errno.ENOSPC: "No space left on device", errno.EDQUOT: "Disk quota exceeded"}
_FEW = 100  # below this many free inodes, the message also says how many more files fit


class NoRoomError(StageError):
    """A file system, or the user's quota on it, is full: exit code 1."""


@contextmanager
def said_when_full(place: Path, what: str = "", partial: Path | None = None, needed: int = 0) -> Iterator[None]:
    """Raises NoRoomError if the block fails because a disk is full. Other errors pass through.

    place: a folder on the file system being written to. what: text to put in front of the message. partial: a folder with what has been
    written so far. needed: total bytes required, or 0 if unknown.
    """
    try:
        yield
    except NoRoomError:
        raise
    except Exception as error:
        found = _full(error)
        if found is None:
            raise
        path, reason = found
        written = bytes_in(partial) if partial is not None else 0
        known = [f"{written} bytes were written"] if partial is not None else []
        known += [f"{needed} are needed"] if needed else []
        known += [_free(folder) for folder in _places(Path(path) if path else place, place)]
        raise NoRoomError(
            f"{what + ': ' if what else ''}{path or place}: {reason}: {'; '.join(known)}. Make room there (`e4dgs store gc` removes "
            "results that no scene uses) or give another --workspace, and run again: finished results are kept"
        ) from error


def _full(error: BaseException | None) -> tuple[str, str] | None:
    """(path, the system's words) if an error was caused by a full disk, else None. The path is "" if it is not known."""
    while error is not None:
        if isinstance(error, OSError) and error.errno in _FULL:
            return str(error.filename2 or error.filename or ""), _FULL[error.errno]  # filename2 is the target of a copy or move
        for words in _FULL.values():
            if words in str(error):  # raised by a library that reports the system's words only
                return "", words
        error = error.__cause__ or error.__context__
    return None


def _places(*paths: Path) -> list[Path]:
    """The nearest existing folder of each path, and the folder for temporary files; only one for each file system."""
    found: dict[int, Path] = {}
    for path in (*paths, Path(tempfile.gettempdir())):
        with suppress(OSError):
            folder = next(one for one in (path, *path.parents) if one.is_dir())
            found.setdefault(folder.stat().st_dev, folder)
    return list(found.values())


def _free(folder: Path) -> str:
    with suppress(OSError):
        found = os.statvfs(folder)
        files = f" and {found.f_favail} more files" if found.f_favail < _FEW and found.f_files > 0 else ""
        return f"{found.f_bavail * found.f_frsize} bytes{files} are free in {folder}"
    return f"it is unknown how much is free in {folder}"
