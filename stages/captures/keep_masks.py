"""Masks of pixels that count, in `masks/` next to `images/` or inside a flat folder of photos. Black pixels are left out of features,
training and metrics. Masks are named as in COLMAP."""

from __future__ import annotations

import posixpath
from collections.abc import Sequence
from pathlib import Path

from . import checks
from .reading import Shot

FOLDER = "masks"


def add_masks(root: Path, shots: Sequence[Shot], beside: str = "images/") -> tuple[str, ...]:
    """Assigns to each shot with file `images/NAME` its mask in `masks/`: NAME.png, as in COLMAP (`a.jpg.png`), or NAME with any image
    suffix. beside: the prefix of NAME, empty for photos in `root` itself. Returns a note for people if the folder exists."""
    if not (root / FOLDER).is_dir():
        return ()
    for shot in shots:
        if shot.file is not None and shot.file.startswith(beside):
            name = f"{FOLDER}/{shot.file.removeprefix(beside)}"
            found = f"{name}.png" if (root / f"{name}.png").is_file() else name if (root / name).is_file() else None
            shot.keep = found or checks.seek_image(root, posixpath.splitext(name)[0], name)
    none = f"{FOLDER}/ has no mask of any image; expected {FOLDER}/NAME.png for {beside}NAME"
    return (told(shots, f"in {FOLDER}/") or none,)


def turn_masks(root: Path, shots: Sequence[Shot]) -> None:
    """Rotates masks of photos that EXIF data rotate, by setting `Shot.keep_turn`, if they have the size of the photo as stored.

    For a square photo, or one rotated by 180 degrees, the size does not tell the orientation of the mask. It is then taken to match the
    stored photo, as for COLMAP, which ignores EXIF. If other masks have a telling size and all match their photos as shown, so does it."""
    told_by_size: list[bool] = []
    unclear: list[tuple[Shot, int]] = []
    for shot in shots:
        if shot.file is None or shot.keep is None or (turn := checks.orientation(root, shot.file)) == 1:
            continue
        size = checks.image_header(root, shot.keep)[:2]
        if turn not in checks.LYING or shot.size[0] == shot.size[1]:
            unclear.append((shot, turn))
        else:
            told_by_size.append(size == shot.size[::-1])
            shot.keep_turn = turn if told_by_size[-1] else 1
    if any(told_by_size) or not told_by_size:
        for shot, turn in unclear:
            shot.keep_turn = turn


def told(shots: Sequence[Shot], where: str) -> str | None:
    count = sum(shot.keep is not None for shot in shots)
    return f"{count} of {len(shots)} images have a mask {where}; its black pixels are left out of training and metrics" if count else None
