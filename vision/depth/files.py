"""Reads a depth map, or the confidence in one, from an untrusted file."""

from __future__ import annotations

import importlib.util
import math
from pathlib import Path
from typing import BinaryIO

import numpy as np

from ...pipeline import CaptureError
from ..images.files import MOST_PIXELS, BadImageError, open_image, pixels
from .exr import exr_size, read_exr
from .lzfse_files import PACKED, read_packed

SUFFIXES = (".png", ".tif", ".tiff", ".npy", ".exr", *PACKED)
IMAGES = (".png", ".tif", ".tiff")
EXTRAS = {".exr": ("OpenEXR", "exr"), **dict.fromkeys(PACKED, ("lzfse", "record3d"))}  # suffix: module that reads it, extra that brings it
GREY = ("I;16", "I;16B", "I;16L", "I", "F", "L")


def missing_extra(name: str) -> str | None:
    """The extra of e4dgs without which the depth map ``name`` cannot be read; None if it can be."""
    module, extra = EXTRAS.get(Path(name).suffix.lower(), (None, None))
    return None if module is None or importlib.util.find_spec(module) is not None else extra


def read_depth(root: Path, name: str, shape: tuple[int, int]) -> np.ndarray:
    """float32 [h, w]: the values of the depth map `root/name` as they are stored; 0 where there is none (also for what is negative or not
    finite). shape: height and width of its picture, for files that do not say their own: those have its ratio. Raises CaptureError if it
    cannot be read or is no map of one channel."""
    again = "copy it again or remove it from the capture"
    if extra := missing_extra(name):
        raise CaptureError(f"{name}: reading it needs: pip install 'e4dgs[{extra}]'")
    suffix = Path(name).suffix.lower()
    try:
        if suffix in PACKED:
            found = read_packed(root / name, shape)
        elif suffix == ".exr":
            found = read_exr(root / name)
        else:
            found = _numpy(root / name) if suffix == ".npy" else _image(root / name)
    except BadImageError as error:
        raise CaptureError(f"{name}: the depth map cannot be read, perhaps cut short ({error}); {again}") from error
    values = found.astype(np.float32)
    return np.where(np.isfinite(values) & (values > 0), values, np.float32(0))


def _image(path: Path) -> np.ndarray:
    with open_image(path) as opened:
        if opened.mode not in GREY:
            raise BadImageError(f"its mode is {opened.mode}, and a depth map has one channel of grey")
        return np.asarray(pixels(opened, upright=False))


def stated_size(path: Path) -> tuple[int, int] | None:
    """Width and height in px of a depth map, from its header alone; None for files that do not say them, as those of `PACKED`. Raises
    BadImageError."""
    suffix = path.suffix.lower()
    if suffix in PACKED:
        return None
    if suffix == ".exr":
        return exr_size(path)
    if suffix == ".npy":
        if not path.is_file():  # opening a pipe would block
            raise BadImageError("it is not a file")
        try:
            with path.open("rb") as file:
                height, width = _header(file, path)[:2]
        except BadImageError:
            raise
        except Exception as error:  # broken headers raise many kinds of errors
            raise BadImageError(str(error) or type(error).__name__) from error
        return width, height
    with open_image(path) as opened:
        return opened.size


def _numpy(path: Path) -> np.ndarray:
    """The array [h, w] or [h, w, 1] of numbers."""
    try:
        with path.open("rb") as file:
            shape = _header(file, path)
            file.seek(0)
            return np.asarray(np.lib.format.read_array(file, allow_pickle=False)).reshape(shape[:2])
    except BadImageError:
        raise
    except Exception as error:  # broken headers raise many kinds of errors
        raise BadImageError(str(error) or type(error).__name__) from error


def _header(file: BinaryIO, path: Path) -> tuple[int, ...]:
    """The shape that the header of an array states, whose claims are checked against the file."""
    version = np.lib.format.read_magic(file)
    header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, _, dtype = header(file)
    plain = dtype.kind in "fiu" and not dtype.hasobject and (len(shape) == 2 or (len(shape) == 3 and shape[2] == 1))
    if not plain or not 0 < math.prod(shape) <= MOST_PIXELS:
        raise BadImageError(f"expected numbers [height, width], found {dtype} {list(shape)}")
    if math.prod(shape) * dtype.itemsize > path.stat().st_size:
        raise BadImageError(f"{list(shape)} are promised, which its {path.stat().st_size} bytes cannot hold")
    return tuple(shape)
