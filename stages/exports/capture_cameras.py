"""The cameras of a capture, for rendering a model from them at any time."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ...pipeline.choice.evenly import evenly

if TYPE_CHECKING:
    from ...rasterizer import Camera
    from ...scene.model import Model
    from ..shared.posed_frameset import PosedFrameSet


def distinct_views(frames: PosedFrameSet, indices: np.ndarray, most: int) -> np.ndarray:
    """At most ``most`` of ``indices``, evenly spread over those with distinct poses, so that a fixed camera counts once."""
    _, first = np.unique(frames.cam_from_world[indices].reshape(len(indices), 16), axis=0, return_index=True)
    own = indices[np.sort(first)]
    return evenly(own, most)


def camera_of(model: Model, frames: PosedFrameSet, i: int) -> Camera:
    """The camera of frame ``i`` with the near plane of ``model``."""
    import torch

    from ...rasterizer import Camera

    K, pose = (torch.tensor(a[i], dtype=torch.float32) for a in (frames.K, frames.cam_from_world))
    return Camera(K, pose, frames.width, frames.height, model.near)
