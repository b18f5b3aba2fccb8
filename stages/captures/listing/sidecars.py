"""Poses in files that lie beside the pictures and are named like them, which their content tells: other programs use such names, too."""

from __future__ import annotations

import posixpath
from collections.abc import Sequence
from pathlib import Path

from .names import is_image

_HEAD = 1 << 16  # bytes that are looked at; such a file has a few thousand
_WORDS = {
    ".xmp": (b"xcr:Rotation",),  # of RealityCapture; those of Lightroom hold settings
    ".json": (b'"cameraPoseARFrame"', b'"intrinsics"'),  # of 3D Scanner App
}


def posed_sidecars(root: Path, files: Sequence[str]) -> set[str]:
    """Those of `files`, relative to `root`, that have the name of a picture beside them and hold its pose or its camera."""
    beside = [path for path in files if path.lower().endswith(tuple(_WORDS))]
    if not beside:
        return set()
    stems = {posixpath.splitext(path)[0].lower() for path in files if is_image(path)}
    return {path for path in beside if posixpath.splitext(path)[0].lower() in stems and _holds_pose(root / path)}


def _holds_pose(file: Path) -> bool:
    try:
        if not file.is_file():  # reading a pipe would block
            return False
        with file.open("rb") as opened:
            head = opened.read(_HEAD)
    except OSError:
        return False
    return any(word in head for word in _WORDS[file.suffix.lower()])
