"""Names of files and folders that no terminal should be shown as they are."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from pathlib import Path

from .captures import mp4, png
from .case import Case

NAMES: dict[str, bytes] = {
    "line break": b"a\nb",
    "escape": b"\x1b[2J\x1b[1;31m",
    "carriage return": b"a\rerror: none",
    "bytes that are no UTF-8": b"\xff\xfe",
    "a surrogate's bytes": b"\xed\xa0\x80",
    "turned writing": "\u202egnp.a".encode(),
    "a line separator": "a\u2028b".encode(),
    "a joined emoji": "\U0001f469\u200d\U0001f680".encode(),
    "narrow space": "at 10.00\u202fAM".encode(),
    "digits of another script": "\u0663\u00b2".encode(),
    "markup": b"[bold]a[red]",
    "a long one": b"x" * 240,
    "many digits": b"9" * 240,
    "an option": b"--force",
    "a shell's words": b"$(touch x); `id` 'a' \"b\"",
    "percent": b"%s%n%03d",
    "nothing but dots": b"...",
}


def cases() -> Iterator[Case]:
    for what, name in NAMES.items():
        yield Case(f"a picture's name: {what}", "images", _file(name + b".png", png()))
        yield Case(f"a video's name: {what}", "videos", _file(name + b".mp4", mp4()))
        yield Case(f"a capture's name: {what}", "images", _renamed(name))
    yield Case("a folder in an n3v camera", "n3v", lambda root: (root / "cam01" / "x.png").mkdir())


def _file(name: bytes, content: bytes) -> Callable[[Path], None]:
    def damage(root: Path) -> None:
        with open(os.path.join(os.fsencode(root), name), "wb") as file:
            file.write(content)

    return damage


def _renamed(name: bytes) -> Callable[[Path], Path]:
    def damage(root: Path) -> Path:
        os.rename(root, target := os.path.join(os.fsencode(root.parent), name))
        return Path(os.fsdecode(target))

    return damage
