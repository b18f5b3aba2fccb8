"""Looks for watermarks and black bars in the pictures of a capture."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ...pipeline import Context
from ...vision.images.black_bars import BarFinder, Bars
from ...vision.images.pictures import composite, read_picture, resize
from ...vision.images.watermark import find_watermark, sampled
from ..captures import Capture
from ..facts import Facts

if TYPE_CHECKING:
    import zarr


def watermark_of(capture: Capture, ctx: Context, decoded: zarr.Array | None) -> np.ndarray | None:
    """What was laid over the pictures of cameras without poses, uint8 [H, W] (255 = watermark or black bar) at the size of the frames,
    still distorted; None if there is nothing, or if ``frames.watermark`` is off. Logs what it finds. Captures with poses are not searched:
    they were prepared, and may show an object that turns in front of a plain wall, whose outline stands still. Of several cameras only bars
    that all have are found.

    decoded: [F, H, W, 3] uint8, the pictures of videos; None if they are in files.
    """
    facts, chosen = Facts.of(capture.facts), sampled(len(capture.names))
    alike = capture.crop is None and capture.turns is None
    if not (ctx.settings.watermark and chosen and alike) or capture.cam_from_world is not None:
        return None

    def picture(i: int) -> np.ndarray:
        if decoded is not None:
            return np.asarray(decoded[i])
        assert capture.images is not None
        return resize(read_picture(capture.root, capture.images[i], facts.upright), facts.width, facts.height)

    around = BarFinder()
    pictures = (around.add(composite(picture(i), capture.background)) for i in chosen)
    found = find_watermark(pictures) if facts.cameras == 1 else None
    for _ in pictures:  # those that nobody has asked for
        pass
    result = np.zeros((facts.height, facts.width), bool)
    if found is not None:
        ctx.log(
            f"{found.mean():.1%} of each picture, such as a watermark, stands still while the camera moves; these pixels are left out "
            "(frames.watermark=false uses them)"
        )
        result |= found
    if (bars := around.found) is not None:
        covered = bars.covered(facts.height, facts.width)
        ctx.log(_told(bars, covered))
        result |= covered
    return np.where(result, 255, 0).astype(np.uint8) if result.any() else None


def _told(bars: Bars, covered: np.ndarray) -> str:
    """A line for people, with FFmpeg's filter that cuts the bars off."""
    height, width = covered.shape
    inside = [(width - bars.left - bars.right) / width, (height - bars.top - bars.bottom) / height, bars.left / width, bars.top / height]
    crop = ":".join(f"{name}*{share:.4f}" for name, share in zip(("iw", "ih", "iw", "ih"), inside, strict=True))
    return (
        f"black bars cover {covered.mean():.0%} of each picture; these pixels are left out (frames.watermark=false uses them); cut them "
        f"off for a sharper scene: ffmpeg -i FILE -vf crop={crop} NEW"
    )
