"""Masks of what counts, `masks/` beside `images/`, as COLMAP reads them: what is black is left out of features, training and metrics."""

from __future__ import annotations

import posixpath
from collections.abc import Sequence
from pathlib import Path

from . import checks
from .capture import Shot

_FOLDER = "masks"


def add_masks(root: Path, shots: Sequence[Shot]) -> tuple[str, ...]:
    """Gives each shot of `images/NAME` the mask in `masks/`: NAME.png, as COLMAP calls it (`a.jpg.png`), or NAME with the suffix of any
    image. A note for people, where there is such a folder."""
    if not (root / _FOLDER).is_dir():
        return ()
    for shot in shots:
        if shot.file is not None and shot.file.startswith("images/"):
            name = f"{_FOLDER}/{shot.file.removeprefix('images/')}"
            found = f"{name}.png" if (root / f"{name}.png").is_file() else name if (root / name).is_file() else None
            shot.keep = found or checks.seek_image(root, posixpath.splitext(name)[0], name)
    return (told(shots, f"in {_FOLDER}/") or f"{_FOLDER}/ has no mask of any image; expected {_FOLDER}/NAME.png for images/NAME",)


def told(shots: Sequence[Shot], where: str) -> str | None:
    count = sum(shot.keep is not None for shot in shots)
    return f"{count} of {len(shots)} images have a mask {where}; its black pixels are left out of training and metrics" if count else None
