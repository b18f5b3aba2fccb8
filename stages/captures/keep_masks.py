"""Masks of pixels that count, in `masks/` next to `images/` or inside a flat folder of photos. Black pixels are left out of features,
training and metrics. Masks are named as in COLMAP, or lie beside their pictures as other programs have them."""

from __future__ import annotations

import posixpath
import shlex
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ...pipeline import CaptureError
from ...pipeline.choice.evenly import evenly
from ...vision.images.pictures import read_mask
from . import checks
from .listing.names import is_image
from .reading import Shot

FOLDER = "masks"
_JUDGED = 8  # masks, from first to last, whose share of black is told
_MOST_BLACK = 0.6  # of the area, from which on masks may mean the opposite


def add_masks(root: Path, shots: Sequence[Shot], beside: str = "images/") -> tuple[str, ...]:
    """Assigns to each shot with file `images/NAME` its mask in `masks/`: NAME.png, as in COLMAP (`a.jpg.png`), or NAME with any image
    suffix; else one that lies beside it, as RealityScan (`a.jpg.mask.png`, `a.mask.png`) and 3DGRUT (`a_mask.png`) have them, whose names
    count in `masks/` as well. beside: the prefix of NAME, empty for photos in `root` itself. Returns a note for people if there are masks
    or the folder exists."""
    there = (root / FOLDER).is_dir()
    pictures, listed = {shot.file for shot in shots}, dict[str, dict[str, str]]()
    own = 0
    for shot in shots:
        if shot.file is None:
            continue
        if there and shot.file.startswith(beside):
            name = f"{FOLDER}/{shot.file.removeprefix(beside)}"
            found = f"{name}.png" if (root / f"{name}.png").is_file() else name if (root / name).is_file() else None
            shot.keep = found or checks.seek_image(root, posixpath.splitext(name)[0], name) or _named(root, name, listed)
        if shot.keep is None and (found := _named(root, shot.file, listed)) not in pictures:
            shot.keep = found
            own += found is not None
    if not there and not own:
        return ()
    none = f"{FOLDER}/ has no mask of any image; expected {FOLDER}/NAME.png for {beside}NAME"
    note = told(root, shots, f"in {FOLDER}/{' or beside them' if own else ''}" if there else "beside them")
    return (note or none,)


def _named(root: Path, path: str, listed: dict[str, dict[str, str]]) -> str | None:
    """The mask in the folder of a picture's ``path`` whose name is made of the picture's. listed: the masks of folders, by their names
    without a suffix, so that each is listed once."""
    folder, name = posixpath.split(path)
    if folder not in listed:
        names = checks.list_files(root / folder) if (root / folder).is_dir() else []
        listed[folder] = {
            posixpath.splitext(n)[0].lower(): n for n in names if is_image(n) and posixpath.splitext(n)[0].lower().endswith("mask")
        }
    stem = posixpath.splitext(name)[0]
    found = next(
        (listed[folder][key] for key in (f"{name}.mask".lower(), f"{stem}.mask".lower(), f"{stem}_mask".lower()) if key in listed[folder]),
        None,
    )
    return None if found is None else posixpath.join(folder, found)


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


def told(root: Path, shots: Sequence[Shot], where: str) -> str | None:
    masked = [shot for shot in shots if shot.keep is not None]
    if not masked:
        return None
    line = f"{len(masked)} of {len(shots)} images have a mask {where}; its black pixels are left out of training and metrics"
    judged = evenly(masked, _JUDGED)
    try:
        black = float(np.mean([(read_mask(root, str(shot.keep)) <= 127).mean() for shot in judged]))
    except CaptureError:  # the stage `frames` refuses it
        return line
    of = "" if len(judged) == len(masked) else f" (judged by {len(judged)} masks)"
    line += f": {black:.0%} of the area{of}"
    if black <= _MOST_BLACK:
        return line
    folder, name = posixpath.split(str(masked[0].keep))
    beside = "mask" if folder == posixpath.dirname(str(masked[0].file)) else ""  # not the pictures
    files = shlex.quote(str(root / folder)) + f"/*{beside}{posixpath.splitext(name)[1]}"
    return f"{line}. If white marks what moves or is to be removed, invert the masks: magick mogrify -negate {files}"
