"""Captures in .zip files: unpacked once, into the workspace and nowhere else."""

from __future__ import annotations

import errno
import os
import shutil
import stat
import tempfile
import zipfile
from collections import Counter
from contextlib import suppress
from pathlib import Path, PurePosixPath

from ...pipeline import CaptureError
from ...pipeline.errors import is_odd
from ...pipeline.files import digest_bytes, digest_file
from ...pipeline.storage.hold import hold

MOST_FILES = 200_000
MOST_TIMES_LARGER = 200  # than the archive; pictures and videos hardly compress, so more is a zip bomb
MOST_FOLDERS = 64  # nested in one another
SLACK = 100_000_000  # bytes that any archive may unpack to in addition


class InUse:
    """A token: as long as it lives, an unpacked archive is in use, see `unpacked`."""


def unpacked(capture: Path, workspace: Path, user: object | None = None) -> Path:
    """``capture`` itself or, for a .zip file, the capture in the folder ``<workspace>/unpacked/<key>/``. An existing folder is reused as it
    is, since the key follows from the archive's name and content. If the archive holds a single folder or file, hidden ones aside, that is
    the capture.

    user: `gc` leaves the folder alone as long as this object lives. Raises CaptureError if the file is not an archive, is damaged, or holds
    paths that lead out of its folder.
    """
    if capture.suffix.lower() != ".zip" or not capture.is_file():
        return capture
    try:
        key = digest_bytes(f"{capture.stem} {digest_file(capture)}".encode("utf-8", "surrogateescape"))[:16]
    except OSError as error:
        raise CaptureError(f"{capture}: cannot be read ({error.strerror or error}); check its permissions and the disk") from error
    folder = workspace / "unpacked" / key
    while not _held(folder, user):
        _make(capture, folder)
    root = folder / capture.stem
    while len(inside := _shown(root)) == 1 and inside[0].is_dir():
        root = inside[0]
    return inside[0] if len(inside) == 1 else root


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


def _make(capture: Path, folder: Path) -> None:
    folder.parent.mkdir(parents=True, exist_ok=True)
    part, user = Path(tempfile.mkdtemp(prefix=f".{folder.name}-", dir=folder.parent)), InUse()
    try:
        mark_of(part).touch()
        hold(user, mark_of(part))  # while it is being filled
        _unpack(capture, part / capture.stem)
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
    try:
        with zipfile.ZipFile(file) as archive:
            members = archive.infolist()
            total = sum(member.file_size for member in members)
            if len(members) > MOST_FILES or total > MOST_TIMES_LARGER * file.stat().st_size + SLACK:
                raise CaptureError(f"{file}: {len(members)} files of {total / 1e9:.1f} GB are too many for a capture; unpack it yourself")
            for member in members:
                _refuse(file, member)
            twice = [name for name, count in Counter(member.filename for member in members).items() if count > 1]
            if twice:
                raise CaptureError(f"{file}: {twice[0]!r} is in it twice; pack it again with one file of that name")
            for member in members:
                archive.extract(member, folder)
    except CaptureError:
        raise
    except OSError as error:
        if error.errno is None:  # bz2's error for damaged data
            raise CaptureError(f"{file}: this archive cannot be unpacked ({error}); pack it again") from error
        raise CaptureError(f"{file}: {error.filename or folder} cannot be written ({error.strerror or error})") from error
    except Exception as error:  # for damaged archives zipfile raises zlib.error, LZMAError, struct.error, ...
        raise CaptureError(f"{file}: this archive cannot be unpacked ({error}); pack it again without a password") from error


def _refuse(file: Path, member: zipfile.ZipInfo) -> None:
    name = PurePosixPath(member.filename.replace("\\", "/"))
    if name.is_absolute() or ".." in name.parts or ":" in member.filename:
        raise CaptureError(f"{file}: {member.filename!r} leads out of the archive's folder; pack it again with relative paths")
    if any(map(is_odd, member.filename)) or len(name.parts) > MOST_FOLDERS:
        raise CaptureError(f"{file}: {member.filename!r} is not a file name; pack it again with plain names, fewer folders deep")
    kind = stat.S_IFMT(member.external_attr >> 16)
    if kind == stat.S_IFLNK:
        raise CaptureError(f"{file}: {member.filename!r} is a link; pack the file that it leads to")
    if kind not in (0, stat.S_IFREG, stat.S_IFDIR):
        raise CaptureError(f"{file}: {member.filename!r} is neither a file nor a folder; leave it out")
