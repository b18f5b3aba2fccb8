"""What kind of archive a file is, told by its first bytes: its name may say something else, or nothing."""

from __future__ import annotations

from pathlib import Path

_BEGINNINGS = {
    b"PK\3\4": "zip",
    b"PK\5\6": "zip",  # without a file
    b"\x1f\x8b": "gzip",
    b"BZh": "bzip2",
    b"\xfd7zXZ\0": "xz",
    b"7z\xbc\xaf\x27\x1c": "7z",
    b"Rar!\x1a\7": "RAR",
    b"\x28\xb5\x2f\xfd": "Zstandard",
}
_TAR = (257, b"ustar")
READ = ("zip", "tar", "gzip", "bzip2", "xz")  # the last three with a tar in them


def archive_kind(file: Path) -> str | None:
    """ "zip", "tar", "gzip", "bzip2", "xz", "7z", "RAR" or "Zstandard"; None if `file` is none of them or cannot be read."""
    try:
        if not file.is_file():  # reading a pipe would block
            return None
        with file.open("rb") as opened:
            head = opened.read(_TAR[0] + len(_TAR[1]))
    except OSError:
        return None
    if head[_TAR[0] :] == _TAR[1]:
        return "tar"
    return next((kind for beginning, kind in _BEGINNINGS.items() if head.startswith(beginning)), None)
