"""Converts flow between distorted pictures to flow between the undistorted pinhole pictures.

Flow is measured between the distorted pictures, so it does not depend on poses. When ten more frames make structure from motion find
slightly different cameras and lens parameters, the measured flow stays valid.
"""

from __future__ import annotations

import numpy as np

from ...vision.warp import sampled
from ..shared.frameset import FrameSet


def straightened(frames: FrameSet, i: int, j: int, flow: np.ndarray, device: str = "cpu") -> np.ndarray:
    """Flow [H, W, 2] float32 px from frame i to frame j between pinhole pictures. ``flow``: the same between distorted pictures.

    A pixel of the pinhole picture i is mapped to the distorted picture i, moved along the flow, and mapped back to the pinhole picture j.
    If the flow leaves the distorted picture j, the distortion at its border is used.
    """
    maps, places = frames.undistortion(i), frames.straight_places(j)
    if maps is None and places is None:
        return flow
    height, width = flow.shape[:2]
    x, y = np.meshgrid(np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32))
    there = flow
    if maps is not None:
        there = sampled(flow, *maps, device)
    from_x, from_y = maps if maps is not None else (x, y)
    to_x, to_y = from_x + there[..., 0], from_y + there[..., 1]
    if places is not None:
        back = places - np.stack([x, y], axis=-1)
        back = sampled(back, to_x, to_y, device)
        to_x, to_y = to_x + back[..., 0], to_y + back[..., 1]
    return np.stack([to_x - x, to_y - y], axis=-1)
