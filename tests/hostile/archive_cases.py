"""Archives that lead out of their folder, grow without end, or lie about what they hold."""

from __future__ import annotations

import gzip
import io
import stat
import struct
import tarfile
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path

from .captures import png
from .case import Case

FILE = "capture.zip"
NAMES = {
    "up": "../out.png",
    "up from within": "a/../../out.png",
    "absolute": "/tmp/out.png",
    "a drive": "C:/out.png",
    "back": "..\\out.png",
    "a line break": "a\nb.png",
    "escape": "\x1b[2J.png",
    "deep": "a/" * 1500 + "a.png",
    "long": "x" * 5000 + ".png",
    "home": "~/out.png",
    "nothing": "",
    "a dot": ".",
    "two dots": "..",
    "turned writing": "\u202egnp.a.png",
}


def cases() -> Iterator[Case]:
    for what, name in NAMES.items():
        yield Case(f"archive: name: {what}", "archive", _packed({"0.png": png(), name: png(1)}), names=(FILE,))
    for what, kind in {"a link": stat.S_IFLNK, "a pipe": stat.S_IFIFO, "a device": stat.S_IFCHR}.items():
        yield Case(f"archive: {what}", "archive", _packed({"0.png": png(), "1.png": "/etc/hostname"}, kind), names=(FILE,))
    pictures = {f"{i}.png": png(i) for i in range(3)}
    yield Case("archive: empty", "archive", _packed({}), names=(FILE,))
    yield Case("archive: one name twice", "archive", _packed(pictures, again="1.png"), names=(FILE,))
    yield Case("archive: file and folder of one name", "archive", _packed({"a": b"x", "a/b.png": png()}), names=(FILE,))
    yield Case("archive: an archive in it", "archive", _packed({"inner.zip": _zip(pictures)}), names=(FILE,))
    yield Case("archive: folders alone", "archive", _packed({"a/": b"", "a/b/": b""}), names=(FILE,))
    yield Case("archive: a text", "archive", _bytes(b"no archive"), names=(FILE,))
    yield Case(
        "archive: zeros", "archive", _packed({"0.png": png(), "zeros.png": bytes(150_000_000)}, method=zipfile.ZIP_DEFLATED), names=(FILE,)
    )
    for method, what in ((zipfile.ZIP_DEFLATED, "deflate"), (zipfile.ZIP_BZIP2, "bzip2"), (zipfile.ZIP_LZMA, "LZMA")):
        yield Case(f"archive: damaged {what}", "archive", _changed(_zip(pictures, method), _damage_data), names=(FILE,))
    for what, name in NAMES.items():
        if name:
            yield Case(f"archive: name in a tar: {what}", "archive", _bytes(_tar(name)), names=(FILE,))
    for what, kind in {"a link": tarfile.SYMTYPE, "a hard link": tarfile.LNKTYPE, "a pipe": tarfile.FIFOTYPE}.items():
        yield Case(f"archive: {what} in a tar", "archive", _bytes(_tar("2.png", kind)), names=(FILE,))
    for what, data in {
        "a terabyte": _tar("2.png", size=2**32),
        "a header of gigabytes": _tar("2.png", tarfile.XHDTYPE, size=2**32),
        "zeros": gzip.compress(_tar("2.png") + bytes(150_000_000), 1),
        "cut": gzip.compress(_tar("2.png"))[:-40],
        "in cut": _tar("2.png")[:1200],
        "7z": b"7z\xbc\xaf\x27\x1c" + bytes(100),
        "RAR": b"Rar!\x1a\7\1\0" + bytes(100),
    }.items():
        yield Case(f"archive: tar: {what}", "archive", _bytes(data), names=(FILE,))
    for what, change in {
        "a size of 2^32": lambda d: _central(d, 24, struct.pack("<I", 2**32 - 2)),
        "a size that is too small": lambda d: _central(d, 24, struct.pack("<I", 3)),
        "a packed size that is too large": lambda d: _central(d, 20, struct.pack("<I", 10**9)),
        "a wrong checksum": lambda d: _central(d, 16, b"XXXX"),
        "an unknown method": lambda d: _central(d, 10, struct.pack("<H", 99)),
        "encrypted": lambda d: _central(d, 8, struct.pack("<H", 1)),
        "an offset behind the end": lambda d: _central(d, 42, struct.pack("<I", 2**31)),
        "all files at one place": lambda d: _overlapping(d),
        "a broken extra field": lambda d: _central(d, 30, struct.pack("<H", 4)),
        "65535 files": lambda d: d[:-14] + struct.pack("<HH", 65535, 65535) + d[-10:],
        "cut at the end": lambda d: d[:-10],
        "cut at the beginning": lambda d: d[100:],
        "cut in the middle": lambda d: d[: len(d) // 2],
    }.items():
        yield Case(f"archive: {what}", "archive", _changed(_zip(pictures), change), names=(FILE,))


def _tar(name: str, kind: bytes = tarfile.REGTYPE, size: int | None = None) -> bytes:
    buffer = io.BytesIO()
    with tarfile.open(fileobj=buffer, mode="w") as archive:
        for other in ("0.png", "1.png", name):
            info, data = tarfile.TarInfo(other), png()
            info.size = len(data)
            if other == name:
                info.type, info.linkname = kind, "/etc/hostname"
            archive.addfile(info, io.BytesIO(data))
    data = bytearray(buffer.getvalue())
    if size is not None:  # of the last entry, which the archive does not hold
        at = data.rindex(name.encode() + b"\0")
        data[at + 124 : at + 136] = b"%011o\0" % size
        data[at + 148 : at + 156] = b" " * 8
        data[at + 148 : at + 156] = b"%06o\0 " % sum(data[at : at + 512])
    return bytes(data)


def _zip(files: dict[str, bytes | str], method: int = zipfile.ZIP_STORED, kind: int = 0, again: str | None = None) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", method) as archive:
        for name, content in files.items():
            info = zipfile.ZipInfo(name or "x")
            info.filename = name
            info.compress_type = method
            if kind and isinstance(content, str):
                info.external_attr = (kind | 0o777) << 16
            archive.writestr(info, content)
        if again is not None:
            archive.NameToInfo.clear()  # else it warns
            archive.writestr(again, b"other")
    return buffer.getvalue()


def _bytes(data: bytes) -> Callable[[Path], None]:
    return lambda root: (root / FILE).write_bytes(data) and None


def _packed(files: dict, kind: int = 0, again: str | None = None, method: int = zipfile.ZIP_STORED) -> Callable[[Path], None]:
    return lambda root: (root / FILE).write_bytes(_zip(files, method, kind, again)) and None


def _changed(data: bytes, change: Callable[[bytes], bytes]) -> Callable[[Path], None]:
    return lambda root: (root / FILE).write_bytes(change(data)) and None


def _central(data: bytes, offset: int, content: bytes) -> bytes:
    """``content`` in the central directory's first record, and at the same place of the local one where that has the field."""
    at = data.index(b"PK\1\2") + offset
    return data[:at] + content + data[at + len(content) :]


def _overlapping(data: bytes) -> bytes:
    result, at = bytearray(data), 0
    while (at := data.find(b"PK\1\2", at + 1)) >= 0:
        result[at + 42 : at + 46] = bytes(4)
    return bytes(result)


def _damage_data(data: bytes) -> bytes:
    at = data.index(b"PK\3\4") + 30 + len("0.png")
    return data[: at + 20] + b"\xff" * 40 + data[at + 60 :]
