"""Writes the cameras and points that structure from motion has found, at the size of the frames and the scale of the world."""

from __future__ import annotations

import numpy as np

from ...pipeline import Context, StageError
from ...vision.images.lenses import pinholes
from ...vision.sfm.coverage import Coverage
from ...vision.sfm.world import POINT_ERROR, keep_points, normalise
from ..shared.frameset import FrameSet
from .artifact import StoredPoses, write_account


def write_poses(ctx: Context, frames: FrameSet, arrays: dict[str, np.ndarray], coverage: Coverage) -> None:
    """Writes the cameras and points of the worker's arrays, and the part of the account that follows from them."""
    registered = arrays["registered"]
    keep = keep_points(arrays["points"], arrays["errors"], arrays["tracks"])
    if not keep.any():
        raise StageError(f"every triangulated point has a reprojection error above {POINT_ERROR} px; try another poses.camera_model")
    K, cam_from_world = arrays["K"], arrays["cam_from_world"]
    # COLMAP read the files, which may be larger than the frames. Pixel centres lie at +0.5 in both, so K scales without an offset.
    size = np.array([frames.width, frames.height]) / np.maximum(arrays["size"], 1)
    K[:, 0] *= size[:, :1]
    K[:, 1] *= size[:, 1:]
    cam_from_world[registered], points = normalise(cam_from_world[registered], arrays["points"][keep])

    lens_K = K
    K, kept = pinholes(lens_K, arrays["distortion"], None, frames.width, frames.height)
    if not kept.all():
        raise StageError(
            f"{frames.names[int(kept.argmin())]}: the lens that was fitted folds the picture over; try another poses.camera_model"
        )
    StoredPoses(
        K=K,
        lens_K=None if np.array_equal(K, lens_K, equal_nan=True) else lens_K,
        cam_from_world=cam_from_world,
        distortion=arrays["distortion"],
        registered=registered,
        points=points,
        point_colors=arrays["colors"][keep],
        point_errors=arrays["errors"][keep],
    ).write(ctx.out)
    write_account(
        ctx.out,
        registered=coverage.registered,
        total=coverage.total,
        gaps=[list(gap) for gap in coverage.gaps],
        mean_track_length=float(arrays["tracks"].mean()),
        camera_model=ctx.settings.camera_model,
        mapper=ctx.settings.mapper,
        advice=list(coverage.advice),
    )
