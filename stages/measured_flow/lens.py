"""Flow between the pictures that a lens made, as flow between the pinhole pictures that they are undistorted to.

Flow is measured between the lens's own pictures. So it does not depend on poses: lens and cameras that structure from motion finds a
little differently, with ten more frames, leave it as it was.
"""

from __future__ import annotations

import cv2
import numpy as np

from ..artifacts.frameset import FrameSet


def straightened(frames: FrameSet, i: int, j: int, flow: np.ndarray) -> np.ndarray:
    """Flow [H, W, 2] float32 px from frame i to frame j, between pinhole pictures, from that between the lens's pictures.

    A pixel of the pinhole picture goes to the lens's picture, along the flow, and back from the other lens's picture. Where the flow leaves
    that, the lens is taken to bend as at its border.
    """
    maps, places = frames.undistortion(i), frames.straight_places(j)
    if maps is None and places is None:
        return flow
    height, width = flow.shape[:2]
    x, y = np.meshgrid(np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32))
    there = flow
    if maps is not None:
        there = cv2.remap(flow, *maps, interpolation=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    from_x, from_y = maps if maps is not None else (x, y)
    to_x, to_y = from_x + there[..., 0], from_y + there[..., 1]
    if places is not None:
        back = places - np.stack([x, y], axis=-1)
        back = cv2.remap(back, to_x, to_y, interpolation=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        to_x, to_y = to_x + back[..., 0], to_y + back[..., 1]
    return np.stack([to_x - x, to_y - y], axis=-1)
