"""`is_fixed`: whether one camera took all of its frames from one place, judged by features that stay where they are."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from ...pipeline.choice.evenly import evenly

SIZE = 1280  # px of the longest side at which features are tracked; larger pictures are scaled down
LOOKS = 6  # frames, spread over the capture, that are compared with the first
TILES, FEATURES = (8, 6), 12  # tiles across and down, and features in each, so that one textured object does not take all features
SHIFT = 0.5  # px, between a feature's place and where most of the others go, within which it goes with them
FIRM, SHAKEN = 0.5, 2.0  # px, how far apart a camera's pictures may lie: on a firm tripod, and with a shake of a pixel to either side
STAY = 0.3  # share of all features that must be found again within `SHIFT`; people walking about may hide or carry the others
FEWEST = 20  # features that must be found again; a plain picture has no evidence


def is_fixed(picture: Callable[[int], np.ndarray], frames: Sequence[int], shake: float = FIRM) -> bool:
    """picture(i): uint8 [H, W, 3] of frame i; frames: those of one camera, in order of time. shake: px by which whole pictures may be
    shifted against one another. False if the pictures give no evidence."""
    if len(frames) < 2:
        return False
    chosen = evenly(frames, LOOKS + 1)
    first = _grey(picture(chosen[0]))
    corners = _corners(first)
    places = [np.zeros(2)]
    for i in chosen[1:] if len(corners) >= FEWEST else ():
        place = _shift(first, _grey(picture(i)), corners)
        if place is None or np.ptp([*places, place], axis=0).max() > shake:
            return False
        places.append(place)
    return len(places) > 1


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


def _shift(first: np.ndarray, other: np.ndarray, corners: np.ndarray) -> np.ndarray | None:
    """[2] px by which the other picture is shifted as a whole; None if too few features of the first agree about that. They are tracked
    there and back; hidden ones drop out."""
    import cv2

    there, found, _ = cv2.calcOpticalFlowPyrLK(first, other, corners, corners.copy())
    back, returned, _ = cv2.calcOpticalFlowPyrLK(other, first, there, corners.copy())
    start, end = corners.reshape(-1, 2), there.reshape(-1, 2)
    good = (found.ravel() > 0) & (returned.ravel() > 0) & (np.linalg.norm(back.reshape(-1, 2) - start, axis=1) < SHIFT)
    if good.sum() < FEWEST:
        return None
    moved = (end - start)[good]
    place = np.median(moved, axis=0)
    together = int((np.linalg.norm(moved - place, axis=1) < SHIFT).sum())
    return np.asarray(place) if together >= max(FEWEST, STAY * len(start)) else None


def _grey(picture: np.ndarray) -> np.ndarray:
    import cv2

    scale = SIZE / max(picture.shape[:2])
    grey = cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY)
    return cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA) if scale < 1 else grey
