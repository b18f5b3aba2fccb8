"""Masks of what counts, `masks/` beside `images/` or beside the photos of a flat folder: what is black is left out of features, training
and metrics. Names are COLMAP's."""

from __future__ import annotations

import posixpath
from collections.abc import Sequence
from pathlib import Path

from . import checks
from .capture import Shot

_FOLDER = "masks"


def add_masks(root: Path, shots: Sequence[Shot], beside: str = "images/") -> tuple[str, ...]:
    """Gives each shot of `images/NAME` the mask in `masks/`: NAME.png, as COLMAP calls it (`a.jpg.png`), or NAME with the suffix of any
    image. beside: what stands before NAME, empty for photos in `root` itself. A note for people, where there is such a folder."""
    if not (root / _FOLDER).is_dir():
        return ()
    for shot in shots:
        if shot.file is not None and shot.file.startswith(beside):
            name = f"{_FOLDER}/{shot.file.removeprefix(beside)}"
            found = f"{name}.png" if (root / f"{name}.png").is_file() else name if (root / name).is_file() else None
            shot.keep = found or checks.seek_image(root, posixpath.splitext(name)[0], name)
    none = f"{_FOLDER}/ has no mask of any image; expected {_FOLDER}/NAME.png for {beside}NAME"
    return (told(shots, f"in {_FOLDER}/") or none,)


def turn_masks(root: Path, shots: Sequence[Shot]) -> None:
    """Masks of photos that EXIF data turn are turned along, `Shot.keep_turn`, where they have the photo's size as stored.

    Of a square photo, or one turned by 180 degrees, no size says how its mask lies: then it is as COLMAP's are, which knows no EXIF,
    unless every mask that tells lies as its photo is shown."""
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


def unread(folder: Path, layout: str) -> tuple[str, ...]:
    """A note where `folder` has masks that nothing looks at."""
    if not (folder / _FOLDER).is_dir():
        return ()
    known = (
        f"{_FOLDER}/ beside images/ (give the folder that holds both), {_FOLDER}/ in a flat folder of photos, mask_path of transforms.json"
    )
    return (f"the folder {_FOLDER}/ is not looked at here, where the layout is {layout}; masks are read from {known}",)
