"""Reads a depth map from an untrusted OpenEXR file."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..images.files import MOST_BYTES, MOST_PIXELS, BadImageError

CHANNELS = ("Z", "depth", "D", "Y", "V", "R")  # names of the channel with depth, the first that is there


def read_exr(path: Path) -> np.ndarray:
    """The channel [h, w] with depth: the only one, or by its name, or the red one of grey colours. Raises BadImageError."""
    import OpenEXR

    width, height = exr_size(path)
    try:
        with OpenEXR.File(str(path), separate_channels=True) as file:
            channels = {name: np.asarray(one.pixels) for name, one in file.channels().items()}
    except Exception as error:  # broken files raise many kinds of errors
        raise BadImageError(str(error) or type(error).__name__) from error
    name = next(iter(channels)) if len(channels) == 1 else next((name for name in CHANNELS if name in channels), None)
    found = None if name is None else channels[name]
    if found is None or found.shape != (height, width):
        raise BadImageError(f"of its channels {', '.join(sorted(channels))}, none is depth ({', '.join(CHANNELS)})")
    if name == "R" and not all(np.array_equal(found, channels[of], equal_nan=True) for of in "GB" if of in channels):
        raise BadImageError("its channels are colours, and a depth map has one channel or three that are equal")
    return found


def exr_size(path: Path) -> tuple[int, int]:
    """Width and height in px, from the header alone. Raises BadImageError."""
    import OpenEXR

    if not path.is_file() or path.stat().st_size > MOST_BYTES:
        raise BadImageError(f"it is not a file, or has more than {MOST_BYTES >> 30} GiB")
    try:
        with OpenEXR.File(str(path), separate_channels=True, header_only=True) as head:
            low, high = head.header()["dataWindow"]
            width, height = (int(h) - int(l) + 1 for l, h in zip(low, high, strict=True))
    except Exception as error:  # broken files raise many kinds of errors
        raise BadImageError(str(error) or type(error).__name__) from error
    if min(width, height) < 1 or width * height > MOST_PIXELS:
        raise BadImageError(f"its size is {width}x{height}")
    return width, height
