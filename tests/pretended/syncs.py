"""What waits for the device, with the place in e4dgs that asked for it."""

from __future__ import annotations

import sys
from pathlib import Path
from types import FrameType
from typing import NamedTuple

import e4dgs.rasterizer
import torch

HERE = Path(__file__).resolve().parent
PACKAGE = Path(e4dgs.rasterizer.__file__).resolve().parents[1]
OUTSIDE = ("tests", "build")  # beside the package's folders where it is used as checked out, as an environment may be
PASSED = (str(HERE), str(HERE.parent / "pretend_cuda.py"), str(Path(torch.__file__).resolve().parent), "<")


class Sync(NamedTuple):
    """what: "item" (also float() and its like), "tolist", "mask" (indexing by one), "download" to the CPU and "upload" from it, both unless
    non_blocking, "synchronize", or the name of an operator that waits: "nonzero", "masked_select", ...
    where: file:line of the innermost code of e4dgs that led there, of the caller where there is none."""

    what: str
    where: str


NOTED: list[list[Sync]] = []  # of every `pretending_cuda` that is entered


def note(what: str) -> None:
    if NOTED:
        sync = Sync(what, _where())
        for notes in NOTED:
            notes.append(sync)


def _where() -> str:
    """The innermost line of the package; of the tests where it does not call."""
    frame: FrameType | None = sys._getframe(2)
    other = ""
    while frame is not None:
        name = frame.f_code.co_filename
        if not name.startswith(PASSED):
            path = Path(name)
            inside = path.is_relative_to(PACKAGE)
            at = f"{path.relative_to(PACKAGE) if inside else path}:{frame.f_lineno}"
            if inside and path.relative_to(PACKAGE).parts[0] not in OUTSIDE and "site-packages" not in path.relative_to(PACKAGE).parts:
                return at
            other = other or at
        frame = frame.f_back
    return other
