"""`Case`: a sound capture and what is done to it."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from .captures import put, write


@dataclass(frozen=True)
class Case:
    """damage: changes the capture in the folder that it is given; what it returns, if anything, e4dgs gets in its place. names: the file,
    and the field, that are damaged: a refusal says each of them."""

    name: str
    layout: str
    damage: Callable[[Path], Path | None]
    options: tuple[str, ...] = ()
    names: tuple[str, ...] = ()

    def make(self, sandbox: Path) -> Path:
        """Writes the capture to the new folder `sandbox/capture`; the path to give to e4dgs."""
        sound = write(self.layout, sandbox / "capture")
        return self.damage(sandbox / "capture") or sound


def replace(file: str, content: bytes | str | dict) -> Callable[[Path], None]:
    return lambda root: put(root, file, content)


def cut(file: str, share: float) -> Callable[[Path], None]:
    """The file ends after that share of it."""

    def damage(root: Path) -> None:
        data = (root / file).read_bytes()
        (root / file).write_bytes(data[: int(share * len(data))])

    return damage


def patch(file: str, find: bytes, offset: int, content: bytes) -> Callable[[Path], None]:
    """``content`` over what stands ``offset`` bytes behind the first ``find``."""

    def damage(root: Path) -> None:
        data = bytearray((root / file).read_bytes())
        at = data.index(find) + offset
        data[at : at + len(content)] = content
        (root / file).write_bytes(data)

    return damage


def sparse(file: str, size: int = 2**40, head: bytes = b"") -> Callable[[Path], None]:
    """A terabyte of zeros that takes no room on the disk, behind ``head``."""

    def damage(root: Path) -> None:
        (root / file).write_bytes(head)
        os.truncate(root / file, size)

    return damage


def node(file: str, kind: str) -> Callable[[Path], None]:
    """Something else than a file of that name: a pipe, a folder, or a link to where ``kind`` says."""

    def damage(root: Path) -> None:
        (root / file).unlink(missing_ok=True)
        if kind == "pipe":
            os.mkfifo(root / file)
        elif kind == "folder":
            (root / file).mkdir()
        else:
            (root / file).symlink_to(kind)

    return damage
