"""Captures in .zip and .tar files: unpacked once, into the workspace and nowhere else."""

from __future__ import annotations

import errno
import os
import re
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path, PurePosixPath

from ...pipeline import CaptureError
from ...pipeline.errors import is_odd
from ...pipeline.files import digest_bytes, digest_file
from ...pipeline.storage.hold import hold
from ...stages.captures.listing.archive_kind import READ, archive_kind
from .archive_members import Member, members_of

MOST_FILES = 200_000
MOST_TIMES_LARGER = 200  # than the archive; pictures and videos hardly compress, so more is a zip bomb
MOST_FOLDERS = 64  # nested in one another
SLACK = 100_000_000  # bytes that any archive may unpack to in addition
_NAMED = (".zip", ".tar", ".tgz", ".tbz2", ".txz", ".7z", ".rar", ".zst", ".tar.gz", ".tar.bz2", ".tar.xz", ".tar.zst")


class InUse:
    """A token: as long as it lives, an unpacked archive is in use, see `unpacked`."""


def unpacked(capture: Path, workspace: Path, user: object | None = None) -> Path:
    """``capture`` itself or, for a .zip or .tar file, the capture in the folder ``<workspace>/unpacked/<key>/``. An existing folder
    is reused as it is, since the key follows from the archive's name and content. If the archive holds a single folder or file, hidden ones
    aside, that is the capture.

    user: `gc` leaves the folder alone as long as this object lives. Raises CaptureError if the file is an archive of another kind, is
    damaged, or holds paths that lead out of its folder.
    """
    stem, suffix = _parted(capture.name)
    kind = archive_kind(capture)
    if not capture.is_file() or (kind is None and not suffix):
        return capture
    if kind is None:
        raise CaptureError(
            f"{capture}: this archive cannot be unpacked (it begins like none, perhaps cut short or empty); copy or pack it again"
        )
    if kind not in READ:
        raise CaptureError(f"{capture}: archives of kind {kind} are not read; unpack it and pass the folder, or pack it as .zip")
    try:
        key = digest_bytes(f"{stem} {digest_file(capture)}".encode("utf-8", "surrogateescape"))[:16]
    except OSError as error:
        raise CaptureError(f"{capture}: cannot be read ({error.strerror or error}); check its permissions and the disk") from error
    folder = workspace / "unpacked" / key
    while not _held(folder, user):
        _make(capture, folder, stem)
    root = folder / stem
    while len(inside := _shown(root)) == 1 and inside[0].is_dir():
        root = inside[0]
    return inside[0] if len(inside) == 1 else root


def _parted(name: str) -> tuple[str, str]:
    """Name and suffix of a file that is named like an archive; no suffix for any other."""
    suffix = max((s for s in _NAMED if name.lower().endswith(s) and len(name) > len(s)), key=len, default="")
    return name.removesuffix(name[len(name) - len(suffix) :]) if suffix else name, suffix


def _shown(folder: Path) -> list[Path]:
    """What a folder holds apart from hidden entries and `__MACOSX`, which macOS adds to archives (`.DS_Store`, `._name`)."""
    return [entry for entry in folder.iterdir() if entry.name != "__MACOSX" and not entry.name.startswith(".")]


def mark_of(folder: Path) -> Path:
    """The file in an unpacked folder that is locked while the folder is in use (`pipeline/storage/hold.py`). Its modification time says
    when the folder was last used."""
    return folder / ".used"


def _held(folder: Path, user: object | None) -> bool:
    """False if nothing is unpacked there, or if it is being removed right now."""
    try:
        if user is not None:
            hold(user, mark_of(folder))
        with suppress(PermissionError):  # a read-only workspace
            os.utime(mark_of(folder))
    except FileNotFoundError:
        return False
    except OSError as error:
        if error.errno != errno.EROFS:
            raise
    return True


def _make(capture: Path, folder: Path, stem: str) -> None:
    folder.parent.mkdir(parents=True, exist_ok=True)
    part, user = Path(tempfile.mkdtemp(prefix=f".{folder.name}-", dir=folder.parent)), InUse()
    try:
        mark_of(part).touch()
        hold(user, mark_of(part))  # while it is being filled
        _unpack(capture, part / stem)
        try:
            os.rename(part, folder)
        except OSError:
            if not folder.is_dir():  # otherwise another run was faster
                raise
            mark_of(folder).touch()
    finally:
        shutil.rmtree(part, ignore_errors=True)


def _unpack(file: Path, folder: Path) -> None:
    folder.mkdir()
    kind = archive_kind(file) or ""
    try:
        with members_of(file, kind) as members:
            for member, path in _checked(file, members):
                target = folder / path
                if member.kind == "folder":
                    target.mkdir(parents=True, exist_ok=True)
                    continue
                target.parent.mkdir(parents=True, exist_ok=True)
                with member.open() as source, target.open("wb") as opened:
                    shutil.copyfileobj(source, opened)
    except CaptureError:
        raise
    except OSError as error:
        if error.errno is None:  # bz2's and gzip's error for damaged data
            raise CaptureError(f"{file}: this archive cannot be unpacked ({error}); pack it again") from error
        raise CaptureError(f"{file}: {error.filename or folder} cannot be written ({error.strerror or error})") from error
    except Exception as error:  # for damaged archives the libraries raise zlib.error, LZMAError, struct.error, TarError, ...
        password = " without a password" if "password" in str(error) or "encrypted" in str(error) else ""
        raise CaptureError(f"{file}: this archive cannot be unpacked ({error}); copy it again, or pack it again{password}") from error


def _checked(file: Path, members: Iterator[Member]) -> list[tuple[Member, PurePosixPath]]:
    """The entries and where they go, once all of them are known to be harmless."""
    most = MOST_TIMES_LARGER * file.stat().st_size + SLACK
    result: dict[PurePosixPath, Member] = {}
    total = 0
    for member in members:
        total += member.size
        if len(result) >= MOST_FILES or total > most:
            raise CaptureError(
                f"{file}: {len(result) + 1} files of {total / 1e9:.1f} GB, and perhaps more, are too many for a capture; unpack it yourself"
            )
        path = _path(file, member)
        if path in result and "folder" not in (member.kind, result[path].kind):
            raise CaptureError(f"{file}: {member.name!r} is in it twice; pack it again with one file of that name")
        if path not in result or member.kind != "folder":
            result[path] = member
    return [(member, path) for path, member in result.items()]


def _path(file: Path, member: Member) -> PurePosixPath:
    name = PurePosixPath(member.name.replace("\\", "/"))
    if name.is_absolute() or ".." in name.parts or re.match("[A-Za-z]:", member.name):
        raise CaptureError(f"{file}: {member.name!r} leads out of the archive's folder; pack it again with relative paths")
    if any(map(is_odd, member.name)) or len(name.parts) > MOST_FOLDERS:
        raise CaptureError(f"{file}: {member.name!r} is not a file name; pack it again with plain names, fewer folders deep")
    if member.kind == "link":
        raise CaptureError(f"{file}: {member.name!r} is a link; pack the file that it leads to")
    if member.kind == "other":
        raise CaptureError(f"{file}: {member.name!r} is neither a file nor a folder; leave it out")
    return PurePosixPath(member.name)
