"""Looks for watermarks in the pictures of a capture."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ...pipeline import Context
from ...vision.images.pictures import read_picture, resize
from ...vision.images.watermark import find_watermark, sampled
from ..captures import Capture
from ..facts import Facts

if TYPE_CHECKING:
    import zarr


def watermark_of(capture: Capture, ctx: Context, decoded: zarr.Array | None) -> np.ndarray | None:
    """The watermark in the pictures of one camera without poses, uint8 [H, W] (255 = watermark) at the size of the frames, still distorted;
    None if there is none, or if ``frames.watermark`` is off. Logs what it finds. Captures with poses are not searched: they were prepared,
    and may show an object that turns in front of a plain wall, whose outline stands still.

    decoded: [F, H, W, 3] uint8, the pictures of videos; None if they are in files.
    """
    facts, chosen = Facts.of(capture.facts), sampled(len(capture.names))
    if not (ctx.settings.watermark and chosen) or capture.cam_from_world is not None or facts.cameras > 1 or capture.crop is not None:
        return None

    def picture(i: int) -> np.ndarray:
        if decoded is not None:
            return np.asarray(decoded[i])
        assert capture.images is not None
        return resize(read_picture(capture.root, capture.images[i], facts.upright), facts.width, facts.height)

    found = find_watermark(picture(i) for i in chosen)
    if found is None:
        return None
    ctx.log(
        f"{found.mean():.1%} of each picture, such as a watermark, stands still while the camera moves; these pixels are left out "
        "(frames.watermark=false uses them)"
    )
    return np.where(found, 255, 0).astype(np.uint8)
