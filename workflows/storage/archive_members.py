"""What an archive holds: its files and folders, by the names that they are to get. Reads .zip, .tar, .tar.gz, .tar.bz2 and .tar.xz."""

from __future__ import annotations

import bz2
import gzip
import lzma
import stat
import tarfile
import unicodedata
import zipfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

_OPEN = {"gzip": gzip.open, "bzip2": bz2.open, "xz": lzma.open}
_FROM_WINDOWS = (0, 10, 11)  # `create_system` of FAT and NTFS
_IN_UTF8 = 0x800  # flag of a name in a .zip file; without it the encoding is that of the computer which packed it
_LARGEST_READ = 2**26  # bytes at once; only a tar's header of false length asks for more


@dataclass(frozen=True)
class Member:
    """One entry. name: with `/` between folders. kind: "file", "folder", "link" or "other". open: its content, for a file."""

    name: str
    size: int
    kind: str
    open: Callable[[], IO[bytes]]


@contextmanager
def members_of(file: Path, kind: str) -> Iterator[Iterator[Member]]:
    """The entries of the archive `file`, in its order. kind: as `archive_kind` tells it. Errors of the libraries for damaged archives pass
    through: they are of many kinds."""
    if kind == "zip":
        with zipfile.ZipFile(file) as archive:
            yield iter(_of_zip(archive))
    else:
        with _OPEN.get(kind, open)(file, "rb") as stream, tarfile.open(fileobj=_Guarded(stream), mode="r:") as tar:  # type: ignore[arg-type, operator, call-overload]
            yield _of_tar(tar, stream)


class _Guarded:
    """A stream that refuses to read much at once, as tarfile does where a header claims to be gigabytes long."""

    def __init__(self, stream: Any) -> None:
        self.stream, self.seek, self.tell = stream, stream.seek, stream.tell

    def read(self, size: int = -1) -> bytes:
        if not 0 <= size <= _LARGEST_READ:
            raise ValueError(f"a header of {size} bytes")
        return bytes(self.stream.read(size))


def _of_tar(tar: tarfile.TarFile, stream: Any) -> Iterator[Member]:
    """The entries, and then a check of the end: tarfile takes what is cut short, or damaged between two files, for a shorter archive."""
    for member in tar:
        yield Member(member.name, member.size, _kind_in_tar(member), _opener(tar, member))
    stream.seek(tar.offset)
    block = stream.read(tarfile.BLOCKSIZE)
    if len(block) % tarfile.BLOCKSIZE or any(block):
        raise ValueError(f"it is damaged or cut short at byte {tar.offset}")
    stream.read(_LARGEST_READ)  # what follows is empty, but compressed data are checked only once their end is reached


def _opener(tar: tarfile.TarFile, member: tarfile.TarInfo) -> Callable[[], IO[bytes]]:
    def opened() -> IO[bytes]:
        content = tar.extractfile(member)
        assert content is not None, "only files are opened"
        return content

    return opened


def _kind_in_tar(member: tarfile.TarInfo) -> str:
    if member.isdir():
        return "folder"
    return "file" if member.isreg() else "link" if member.issym() or member.islnk() else "other"


def _of_zip(archive: zipfile.ZipFile) -> list[Member]:
    infos = archive.infolist()
    names = [_decoded(info) for info in infos]
    # Windows PowerShell 5 and old .NET write `\` between folders. In an archive of another system it may be part of a name.
    slashed = any("/" in name for name in names)
    result = []
    for info, name in zip(infos, names, strict=True):
        if info.create_system in _FROM_WINDOWS or not slashed:
            name = name.replace("\\", "/")
        mode = stat.S_IFMT(info.external_attr >> 16)
        kind = {0: "file", stat.S_IFREG: "file", stat.S_IFDIR: "folder", stat.S_IFLNK: "link"}.get(mode, "other")
        result.append(Member(name, info.file_size, "folder" if name.endswith("/") else kind, lambda info=info: archive.open(info)))  # type: ignore[misc]
    return result


def _decoded(info: zipfile.ZipInfo) -> str:
    """The name. Python takes one without the flag of UTF-8 for code page 437, but macOS writes UTF-8 and Japanese Windows Shift-JIS."""
    if info.flag_bits & _IN_UTF8 or info.filename.isascii():
        return info.filename
    raw = info.filename.encode("cp437")
    for encoding in ("utf-8", "cp932"):
        try:
            name = raw.decode(encoding)
        except UnicodeDecodeError:
            continue
        if encoding == "utf-8" or all(c.isascii() or unicodedata.name(c, "").startswith(("CJK", "HIRAGANA", "KATAKANA")) for c in name):
            return name
    return info.filename
