"""The poses of one camera that stands still: the same for all frames, with a lens that is known or assumed. No structure from motion."""

from __future__ import annotations

import numpy as np

from ...pipeline import Context
from ...vision.images.focal_length import focal_length
from ..facts import STANDS_STILL
from ..shared.frameset import FrameSet
from .artifact import StoredPoses, write_account

ASSUMED = 1.0  # focal length, of the longer side: a field of view of 53 degrees, between those of phones (65) and of cameras (40)


def write_standing(ctx: Context, frames: FrameSet) -> None:
    """Writes one pose, the origin of the world, for all frames, and no points."""
    K, told = lens_of(frames)
    count = len(frames)
    ctx.log(f"the camera stands still: one pose for all {count} frames, without structure from motion")
    ctx.log(told)
    ctx.log(STANDS_STILL)
    StoredPoses(
        K=np.repeat(K[None], count, axis=0),
        cam_from_world=np.repeat(np.eye(4)[None], count, axis=0),
        distortion=np.zeros((count, 4)),
        registered=np.ones(count, bool),
        points=np.zeros((0, 3)),
        point_colors=np.zeros((0, 3), np.uint8),
        point_errors=np.zeros(0),
    ).write(ctx.out)
    write_account(ctx.out, registered=count, total=count, gaps=[], notes=[told], advice=[], fixed_cameras=True, limits=STANDS_STILL)


def lens_of(frames: FrameSet) -> tuple[np.ndarray, str]:
    """K [3, 3] px and where it comes from: `K.txt`, the focal length in the data of the first picture, or an assumption."""
    if frames.K_hint is not None:
        return np.asarray(frames.K_hint, np.float64).reshape(3, 3), "lens: K.txt"
    longer = max(frames.width, frames.height)
    known = focal_length(frames.root / frames.files[0]) if frames.files is not None and frames.crop is None else None
    focal = longer * (ASSUMED if known is None else known)
    K = np.array([[focal, 0, frames.width / 2], [0, focal, frames.height / 2], [0, 0, 1.0]])
    degrees = 2 * np.degrees(np.arctan(longer / (2 * focal)))
    if known is not None:
        return K, f"lens: {degrees:.0f} degrees along the longer side, from the EXIF data of {frames.names[0]}"
    return K, (
        f"lens: {degrees:.0f} degrees along the longer side are assumed, since no file tells; K.txt, a camera matrix of nine numbers, "
        "sets it, in the folder that is the capture, with the pictures or the video"
    )
