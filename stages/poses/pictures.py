"""Writes the pictures and masks of a capture as files for COLMAP."""

from __future__ import annotations

import os
import shutil
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from PIL import Image

from ...pipeline import Context
from ...pipeline.files import written_beside
from ...vision.images.files import open_image
from ...vision.images.focal_length import DETAILS, EQUIVALENT, film_focal_length
from ...vision.images.pictures import composite

if TYPE_CHECKING:
    from ..shared.frameset import FrameSet

# How files begin that COLMAP reads: PNG, JPEG, BMP, TIFF (and TIFF above 4 GB). It reads no WebP, and no BMP without a file header.
_READ_BY_COLMAP = (b"\x89PNG", b"\xff\xd8\xff", b"BM", b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")


def picture_folder(ctx: Context) -> Path:
    """The folder of the pictures, created if it does not exist."""
    folder = ctx.checkpoints / "images"
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def write_images(ctx: Context, frames: FrameSet) -> list[str]:
    """Writes pictures for COLMAP under plain names and returns the names. They are links to the capture's own files if COLMAP can use all
    of them, otherwise new PNG files of the frames' size."""
    folder = picture_folder(ctx)
    names: list[str] = []
    # COLMAP reads files as they are stored: it does not rotate, crop or composite them. Masks need pictures of the frames' size.
    plain = not frames.alpha and not frames.upright and frames.crop is None and not frames.masked and set(frames.turns) == {1}
    linked = frames.files is not None and plain and all(_read_by_colmap(frames.root / file) for file in frames.files)
    with ctx.progress(len(frames), "pictures") as progress:
        for i in range(len(frames)):
            suffix = Path(frames.files[i]).suffix.lower() if linked and frames.files is not None else ".png"
            names.append(f"{frames.number[i]:06d}{suffix}")
            target = folder / names[-1]
            if not target.exists():
                target.unlink(missing_ok=True)  # a dangling link, whose target has moved
                if linked and frames.files is not None:
                    _link(frames.root / frames.files[i], target)
                else:
                    part = None if frames.crop is None else frames.crop[i]
                    exif = _focal_length(frames.root / frames.files[i], part) if frames.files is not None else None
                    _save(frames, i, target, exif)
            progress.advance()
    return names


def write_picture(frames: FrameSet, i: int, folder: Path) -> str:
    """Writes the picture of frame ``i`` as PNG and returns its name. An existing file is kept."""
    target = folder / f"{frames.number[i]:06d}.png"
    if not target.exists():
        _save(frames, i, target)
    return target.name


def write_masks(ctx: Context, frames: FrameSet) -> Path:
    """Writes masks, black where no features are to be detected, and returns their folder. As COLMAP wants it, a mask is named after its
    picture, with .png appended."""
    folder = ctx.checkpoints / "masks"
    folder.mkdir(parents=True, exist_ok=True)
    for i in range(len(frames)):
        kept = frames.kept(i)
        if kept is not None:
            Image.fromarray(np.where(kept, 255, 0).astype(np.uint8)).save(folder / f"{frames.number[i]:06d}.png.png", compress_level=1)
    return folder


def _save(frames: FrameSet, i: int, target: Path, exif: Image.Exif | None = None) -> None:
    with written_beside(target) as part:
        Image.fromarray(composite(frames.original(i), frames.background)).save(part, compress_level=1, exif=exif)


def _focal_length(file: Path, part: np.ndarray | None) -> Image.Exif:
    """EXIF data with only the picture's 35 mm equivalent focal length, from which COLMAP initialises the intrinsics. part: left, top,
    width, height, px, of what is used of the file, whose focal length is that of the whole; None for the whole."""
    result, value = Image.Exif(), film_focal_length(file)
    if value is not None and part is not None:
        with open_image(file) as image:
            value = round(value * max(image.size) / max(part[2:].tolist()))
    if value is not None:
        result[DETAILS] = {EQUIVALENT: value}
    return result


def _read_by_colmap(file: Path) -> bool:
    """Whether COLMAP reads such a file. Its content decides, as it does for COLMAP; a WebP file may be called .jpg."""
    try:
        with file.open("rb") as opened:
            return opened.read(4).startswith(_READ_BY_COLMAP)
    except OSError:  # decoding it says what is wrong
        return False


def _link(source: Path, target: Path) -> None:
    with written_beside(target) as part:
        try:
            os.symlink(source.resolve(), part)
        except OSError:  # a file system without links
            shutil.copyfile(source, part)
