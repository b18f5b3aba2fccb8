"""Masks of moving pixels in the training frames of one camera, from small pictures collected while flow is measured at full size."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Executor, Future

import cv2
import numpy as np

from ...vision.flow.two_way import FlowPair
from ...vision.images.pictures import size_within
from ...vision.moving.fixed_camera import fixed_camera_masks
from ...vision.moving.moving_masks import moving_masks
from ..shared.frameset import FrameSet

# px, longest side at which moving pixels are detected. On `room_mono` (480x270, true poses) masks made at 240 and 160 px have an
# intersection over union with the truth of 0.866 and 0.862, and the time is proportional to the area. The background model of a fixed
# camera costs less.
SIZE = 160
FIXED_SIZE = 240
GAPS = (1, 3)  # distances to the frames on either side that each frame is compared with; as good here as three, in two thirds of the time
STRETCH = 16  # frames per job


class MovingMasks:
    """Collects small pictures and flow of one camera, then computes its masks. Frames are numbered 0, 1, ... in order of time. Any thread
    may add.

    width, height: px of the full pictures. K [F, 3, 3] px for these and cam_from_world [F, 4, 4], or None for both. fixed: the camera
    stands still, so its background is used, which is more reliable than flow.
    """

    def __init__(self, width: int, height: int, K: np.ndarray | None, cam_from_world: np.ndarray | None, fixed: bool) -> None:
        self._full = width, height
        self._size = size_within(width, height, FIXED_SIZE if fixed else SIZE)
        self._shrink = np.array([self._size[0] / width, self._size[1] / height], np.float32)
        self._fixed, self._poses = fixed, cam_from_world
        self._K = None if K is None else K * np.array([self._shrink[0], self._shrink[1], 1.0])[:, None]
        self._pictures: dict[int, np.ndarray] = {}
        self._pairs: dict[int, FlowPair] = {}

    @classmethod
    def of_camera(cls, frames: FrameSet, mine: list[int], fixed: bool) -> MovingMasks:
        """For the frames ``mine`` of one camera, in order of time."""
        if frames.K is None or frames.cam_from_world is None:
            return cls(frames.width, frames.height, None, None, fixed)
        return cls(frames.width, frames.height, frames.K[mine], frames.cam_from_world[mine], fixed)

    def add_picture(self, k: int, picture: np.ndarray) -> None:
        """Frame ``k``, uint8 [H, W, 3]."""
        self._pictures[k] = cv2.resize(picture, self._size, interpolation=cv2.INTER_AREA)

    def add_pair(self, k: int, pair: FlowPair) -> None:
        """Flow between frames ``k`` and ``k`` + 1 at full size. Ignored for a fixed camera, which needs none."""
        if self._fixed:
            return
        forward, backward = (
            (cv2.resize(flow, self._size, interpolation=cv2.INTER_AREA) * self._shrink).astype(np.float16)
            for flow in (pair.forward, pair.backward)
        )
        self._pairs[k] = FlowPair(forward, backward, cv2.resize(pair.confidence, self._size, interpolation=cv2.INTER_AREA))

    def masks(self, pool: Executor) -> list[Future[list[np.ndarray]]]:
        """Submits jobs. Their results, joined in order, are the full-size masks uint8 [H, W] of all frames, 255 = moves. Nothing may be
        added afterwards."""
        count = len(self._pictures)
        pictures = [self._pictures[k] for k in range(count)]
        if self._fixed:
            return [pool.submit(lambda: [self._grown(mask) for mask in fixed_camera_masks(pictures)])]
        pairs: Sequence[FlowPair | None] = [self._pairs.get(k) for k in range(count - 1)]
        make: Callable[[range], list[np.ndarray]] = lambda only: [  # noqa: E731
            self._grown(mask) for mask in moving_masks(pictures.__getitem__, pairs, self._K, self._poses, GAPS, only)
        ]
        return [pool.submit(make, range(start, min(start + STRETCH, count))) for start in range(0, count, STRETCH)]

    def _grown(self, mask: np.ndarray) -> np.ndarray:
        grown = cv2.resize(mask, self._full, interpolation=cv2.INTER_LINEAR)
        return np.where(grown > 127, 255, 0).astype(np.uint8)
