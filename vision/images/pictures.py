"""Decodes image files, and resizes and undistorts pictures with or without alpha. Imports OpenCV inside functions."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ...pipeline import CaptureError
from .colour_profile import in_srgb
from .files import BadImageError, open_image, pixels

if TYPE_CHECKING:
    from PIL.Image import Image

Say = Callable[[str], None]
TRUTH = "masks hold only 0 and 1, of which 1 is taken for white"
ALPHA = "masks of one colour hold their shape in alpha, of which opaque is taken for white"
CUT_OUT = "masks are pictures that are cut out, of which opaque is taken for white; save them without alpha if their brightness is meant"
_MASK_GREY = 32  # of 255: as far from black or white, and as far apart in colour, a pixel may still be one of a mask
_MOST_EDGES = 0.1  # of the opaque pixels of a mask: soft edges

# What each EXIF orientation (tag 0x0112) does to an array [H,W].
_TURNS: dict[int, Callable[[np.ndarray], np.ndarray]] = {
    1: lambda a: a,
    2: np.fliplr,
    3: lambda a: np.rot90(a, 2),
    4: np.flipud,
    5: np.transpose,
    6: lambda a: np.rot90(a, -1),
    7: lambda a: np.rot90(a, 2).T,
    8: np.rot90,
}
# What 6, a quarter turn clockwise, does to a camera: its axes [4,4], x right and y down, from those before.
CLOCKWISE = np.array([[0.0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])


def read_picture(root: Path, name: str, upright: bool = False, say: Say = lambda what: None) -> np.ndarray:
    """uint8 [H,W,3], or [H,W,4] with straight alpha, of `root/name` as stored (as COLMAP reads it), but with the colours that its file
    means, as sRGB. upright: rotated by its EXIF orientation. say: called with what was done about them."""
    try:
        with open_image(root / name) as opened:
            image = pixels(opened, upright)
            alpha = "A" in image.getbands() or "transparency" in image.info
            image = in_srgb(image, say)
            if image.mode.startswith("I;16"):
                return np.repeat(_eight_bits(image)[..., None], 3, axis=2)
            return np.asarray(image.convert("RGBA" if alpha else "RGB"))
    except BadImageError as error:
        raise CaptureError(
            f"{name}: cannot be decoded, perhaps cut short ({error}); copy it again or remove it from the capture"
        ) from error


def read_mask(root: Path, name: str, turn: int = 1, say: Say = lambda what: None) -> np.ndarray:
    """uint8 [H,W] of a mask file of 1, 8 or 16 bits; 255 is masked. In a mask that holds only 0 and 1, as programs save truth values, 1
    is masked; in one of one colour, or with colours, whose alpha is not the same everywhere, alpha is the mask. turn: the EXIF
    orientation of the photo, given if the mask has the photo's size as stored, so that both are rotated alike. say: called with `TRUTH`,
    `ALPHA` or `CUT_OUT` for such masks."""
    try:
        with open_image(root / name) as opened:
            image = pixels(opened, upright=False)
            values = np.asarray(image if image.mode.startswith("I;16") else image.convert("L"))
            if (alpha := _shape_in_alpha(image, values)) is not None:
                say(ALPHA if values.min() == values.max() else CUT_OUT)
                values = alpha
            truth = values.max() == 1
            mask = (values * 255).astype(np.uint8) if truth else values if values.dtype == np.uint8 else _eight_bits(image)
            if truth:
                say(TRUTH)
            return turned(mask, turn)
    except BadImageError as error:
        raise CaptureError(f"{name}: the mask cannot be decoded, perhaps cut short ({error}); copy it again or remove it") from error


def _shape_in_alpha(image: Image, values: np.ndarray) -> np.ndarray | None:
    """uint8 [H,W]: alpha if it says what a mask with the grey ``values`` should say: where these are all equal, or the picture that is cut
    out shows more than black and white; else None."""
    if values.dtype != np.uint8 or not ("A" in image.getbands() or "transparency" in image.info):
        return None
    colours = np.asarray(image.convert("RGBA"))
    alpha = np.ascontiguousarray(colours[..., 3])
    if alpha.min() == alpha.max():
        return None
    if values.min() == values.max():
        return alpha
    opaque = colours[alpha > 127][:, :3].astype(int)
    if not 0 < len(opaque) < alpha.size:
        return None
    shown = (np.minimum(opaque, 255 - opaque).max(axis=1) > _MASK_GREY) | (np.ptp(opaque, axis=1) > _MASK_GREY)
    return alpha if shown.mean() > _MOST_EDGES else None


def read_keep(root: Path, name: str, turn: int = 1, say: Say = lambda what: None) -> np.ndarray:
    """uint8 [H,W]: 255 for pixels that count, 0 where the mask file is black, which excludes pixels. turn, say: see `read_mask`."""
    keep = np.where(read_mask(root, name, turn, say) > 127, 255, 0).astype(np.uint8)
    if not keep.any():
        raise CaptureError(f"{name}: the mask is black everywhere, so nothing of its image counts; invert the masks, or remove this one")
    return keep


def turned(picture: np.ndarray, turn: int) -> np.ndarray:
    """``picture`` [H,W] turned as an EXIF orientation asks; [H,W,C] only if that is 1, 3, 6 or 8."""
    return np.ascontiguousarray(_TURNS[turn](picture))


def resize(picture: np.ndarray, width: int, height: int, crop: np.ndarray | None = None) -> np.ndarray:
    """Scales down (area average) or up (bicubic); returns the picture itself if it has that size already. crop: left, top, width, height in
    px of the part to use."""
    import cv2

    if crop is not None:
        left, top, across, down = (int(v) for v in crop)
        picture = np.ascontiguousarray(picture[top : top + down, left : left + across])
    if picture.shape[:2] == (height, width):
        return picture
    way = cv2.INTER_AREA if width * height < picture.shape[0] * picture.shape[1] else cv2.INTER_CUBIC
    return _premultiplied(picture, lambda p: cv2.resize(p, (width, height), interpolation=way))


def size_within(width: int, height: int, max_size: int | None) -> tuple[int, int]:
    """Width and height, scaled down so that neither exceeds ``max_size`` px; unchanged if neither does."""
    if max_size is None or max(width, height) <= max_size:
        return width, height
    scale = max_size / max(width, height)
    return max(1, round(width * scale)), max(1, round(height * scale))


def shrunk(picture: np.ndarray, max_size: int | None) -> np.ndarray:
    """``picture`` [H,W,...] scaled down by area averaging to a longest side of ``max_size`` px; itself if no side is longer. Contiguous."""
    import cv2

    height, width = picture.shape[:2]
    size = size_within(width, height, max_size)
    if size == (width, height):
        return np.ascontiguousarray(picture)
    return cv2.resize(picture, size, interpolation=cv2.INTER_AREA)


def size_of(root: Path, name: str) -> tuple[int, int]:
    """Width and height in px of the picture `root/name` as stored. Raises CaptureError."""
    try:
        with open_image(root / name) as opened:
            return opened.width, opened.height
    except BadImageError as error:
        raise CaptureError(f"{name}: cannot be opened ({error}); copy it again or remove it from the capture") from error


def nearest(
    values: np.ndarray, width: int, height: int, part: np.ndarray | None = None, maps: tuple[np.ndarray, np.ndarray] | None = None
) -> np.ndarray:
    """``values`` [h, w] at another size, each the one nearest to its pixel. part: left, top, width and height of what is used, as shares of
    the whole. maps: see `undistort`."""
    import cv2

    left, top, across, down = (0.0, 0.0, 1.0, 1.0) if part is None else part
    column = ((left + across * (np.arange(width) + 0.5) / width) * values.shape[1]).astype(int).clip(0, values.shape[1] - 1)
    row = ((top + down * (np.arange(height) + 0.5) / height) * values.shape[0]).astype(int).clip(0, values.shape[0] - 1)
    sized = np.ascontiguousarray(values[row[:, None], column[None]])
    return sized if maps is None else cv2.remap(sized, *maps, interpolation=cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT)


def undistort(picture: np.ndarray, maps: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """Resamples `picture` (bicubic) to the pinhole image. Beyond the source's border its edge pixels are repeated."""
    import cv2

    return _premultiplied(picture, lambda p: cv2.remap(p, *maps, interpolation=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE))


def composite(picture: np.ndarray, background: str | None) -> np.ndarray:
    """uint8 [H,W,3]: straight alpha over "white" or "black" (None counts as black), rounded to nearest."""
    if picture.shape[2] == 3:
        return picture
    alpha = picture[..., 3:].astype(np.uint16)
    total = picture[..., :3] * alpha + (255 if background == "white" else 0) * (255 - alpha)
    return ((total + 127) // 255).astype(np.uint8)


def _eight_bits(image: Image) -> np.ndarray:
    """Scales 16-bit grey to uint8 [H,W]. Pillow would clip it instead."""
    return np.rint(np.asarray(image, np.float32) / 257).astype(np.uint8)


def _premultiplied(picture: np.ndarray, operation: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
    """Resamples with premultiplied alpha, so that colours under alpha 0 do not bleed into visible pixels."""
    if picture.ndim == 2 or picture.shape[2] == 3:
        return operation(picture)
    values = picture.astype(np.float32)
    values[..., :3] *= values[..., 3:] / 255
    values = np.clip(operation(values), 0, 255)
    alpha = values[..., 3:]
    values[..., :3] = np.where(alpha > 0, values[..., :3] * 255 / np.maximum(alpha, 1e-6), 0)
    return np.clip(np.rint(values), 0, 255).astype(np.uint8)
