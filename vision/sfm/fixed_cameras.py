"""`is_fixed`: whether one camera took all of its frames from one place, judged by features that stay where they are."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

SIZE = 1280  # px of the longest side at which features are tracked; larger pictures are scaled down
LOOKS = 6  # frames, spread over the capture, that are compared with the first
TILES, FEATURES = (8, 6), 12  # tiles across and down, and features in each, so that one textured object does not take all features
SHIFT = 0.5  # px, limit for the median apparent motion of the features that can be tracked
STAY = 0.3  # share of all features that must be found again within `SHIFT`; people walking about may hide or carry the others
FEWEST = 20  # features that must be found again; a plain picture has no evidence


def is_fixed(picture: Callable[[int], np.ndarray], frames: Sequence[int]) -> bool:
    """picture(i): uint8 [H, W, 3] of frame i; frames: those of one camera, in order of time. False if the pictures give no evidence."""
    if len(frames) < 2:
        return False
    chosen = [frames[k] for k in np.unique(np.linspace(0, len(frames) - 1, LOOKS + 1).round().astype(int))]
    first = _grey(picture(chosen[0]))
    corners = _corners(first)
    return len(corners) >= FEWEST and all(_unmoved(first, _grey(picture(i)), corners) for i in chosen[1:])


def _corners(picture: np.ndarray) -> np.ndarray:
    """[N, 1, 2] float32 px."""
    import cv2

    (across, down), (height, width) = TILES, picture.shape
    found = []
    for j in range(down):
        for i in range(across):
            left, top = i * width // across, j * height // down
            tile = picture[top : (j + 1) * height // down, left : (i + 1) * width // across]
            corners = cv2.goodFeaturesToTrack(tile, FEATURES, 0.05, 5, blockSize=7)
            if corners is not None:
                found.append((corners + np.array([left, top])).astype(np.float32))
    return np.concatenate(found) if found else np.zeros((0, 1, 2), np.float32)


def _unmoved(first: np.ndarray, other: np.ndarray, corners: np.ndarray) -> bool:
    """Whether features of the first picture are at the same places in the other. They are tracked there and back; hidden ones drop out."""
    import cv2

    there, found, _ = cv2.calcOpticalFlowPyrLK(first, other, corners, corners.copy())
    back, returned, _ = cv2.calcOpticalFlowPyrLK(other, first, there, corners.copy())
    start, end = corners.reshape(-1, 2), there.reshape(-1, 2)
    good = (found.ravel() > 0) & (returned.ravel() > 0) & (np.linalg.norm(back.reshape(-1, 2) - start, axis=1) < SHIFT)
    shift = np.linalg.norm(end - start, axis=1)[good]
    stay = int((shift < SHIFT).sum())
    return stay >= max(FEWEST, STAY * len(start)) and float(np.median(shift)) < SHIFT


def _grey(picture: np.ndarray) -> np.ndarray:
    import cv2

    scale = SIZE / max(picture.shape[:2])
    grey = cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY)
    return cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA) if scale < 1 else grey
