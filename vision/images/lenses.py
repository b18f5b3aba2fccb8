"""Undistortion to a pinhole camera all of whose pixels the lens saw. Imports OpenCV inside functions."""

from __future__ import annotations

import numpy as np

MOST_ZOOM = 2.0  # times the lens's focal length; a picture that would need more has wrong distortion terms
GRID = 129  # grid points per side at which a lens is checked
STEPS = 24  # of bisection: the zoom is accurate to 2e-7


def undistort_maps(
    K: np.ndarray, distortion: np.ndarray, width: int, height: int, lens_K: np.ndarray | None = None, fisheye: bool = False
) -> tuple[np.ndarray, np.ndarray]:
    """Where each pixel of the pinhole image lies in the distorted picture of the same size, for `pictures.undistort`.

    K (pinhole) and lens_K (distorted picture; K if not given) [3,3] px, pixel centres at +0.5. distortion [4] or [8] in OpenCV's order
    (`captures/lens.py`).
    """
    # OpenCV counts pixel centres from 0.
    half = np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])
    return _maps(np.asarray(K, np.float64) - half, np.asarray(K if lens_K is None else lens_K) - half, distortion, fisheye, width, height)


def straight_places(
    K: np.ndarray, distortion: np.ndarray, width: int, height: int, lens_K: np.ndarray, fisheye: bool = False
) -> np.ndarray:
    """The inverse: where each pixel of the distorted image lies in the pinhole image K, float32 [height, width, 2] px, counted from 0.

    Positions are clipped to one picture size outside the pinhole image. Beyond that, and where the distortion folds the picture over, they
    carry no information. Arguments as for `undistort_maps`.
    """
    import cv2

    half = np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])
    seen, shown, terms = np.asarray(lens_K, np.float64) - half, np.asarray(K, np.float64) - half, np.asarray(distortion, np.float64)
    pixels = np.stack(np.meshgrid(np.arange(width, dtype=np.float64), np.arange(height, dtype=np.float64)), axis=-1).reshape(-1, 1, 2)
    until = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 40, 1e-8)
    if fisheye:
        places = cv2.fisheye.undistortPoints(pixels, seen, terms[:4], None, np.eye(3), shown, until)
    else:
        places = cv2.undistortPoints(pixels, seen, terms, None, np.eye(3), shown, until)
    size = np.array([width, height], np.float64)
    places = np.clip(np.nan_to_num(places, nan=-np.inf), -size, 2 * size)
    return places.reshape(height, width, 2).astype(np.float32)


def pinholes(
    lens_K: np.ndarray, distortion: np.ndarray, fisheye: np.ndarray | None, width: int, height: int
) -> tuple[np.ndarray, np.ndarray]:
    """(K [F,3,3] px of the pinhole cameras that the frames are undistorted to, kept [F]: share of each picture's area that they show).

    If the lens saw every pixel of a pinhole camera with its own K, that K is used: nothing is enlarged in the middle, and what a barrel or
    fisheye lens saw beyond it is left out. Otherwise the focal length is the smallest longer one that leaves no pixel without data. kept
    is 1 without distortion, and 0 if even `MOST_ZOOM` times the focal length is not enough (K is then the lens's). NaN rows stay, with
    kept 1.
    """
    K, kept = np.array(lens_K, np.float64), np.ones(len(lens_K))
    known: dict[bytes, tuple[np.ndarray, float]] = {}
    round_ = np.zeros(len(lens_K), bool) if fisheye is None else fisheye.astype(bool)
    for i in np.flatnonzero((distortion.any(1) | round_) & np.isfinite(lens_K).all((1, 2))):
        key = lens_K[i].tobytes() + distortion[i].tobytes() + bytes([bool(round_[i])])
        if key not in known:
            known[key] = _pinhole(np.asarray(lens_K[i], np.float64), distortion[i], bool(round_[i]), width, height)
        K[i], kept[i] = known[key]
    return K, kept


def _pinhole(lens_K: np.ndarray, distortion: np.ndarray, fisheye: bool, width: int, height: int) -> tuple[np.ndarray, float]:
    """One camera's (K, kept)."""
    seen = _seen(lens_K, lens_K, distortion, fisheye, width, height)
    if seen is not None:
        return lens_K, seen
    low, high = 1.0, MOST_ZOOM
    kept = _seen(_zoomed(lens_K, high, width, height), lens_K, distortion, fisheye, width, height)
    if kept is None:
        return lens_K, 0.0
    for _ in range(STEPS):
        middle = 0.5 * (low + high)
        seen = _seen(_zoomed(lens_K, middle, width, height), lens_K, distortion, fisheye, width, height)
        if seen is None:
            low = middle
        else:
            high, kept = middle, seen
    return _zoomed(lens_K, high, width, height), kept


def _zoomed(K: np.ndarray, zoom: float, width: int, height: int) -> np.ndarray:
    """K with a longer focal length, zoomed about the picture's centre."""
    middle = np.array([[1, 0, 0.5 * width], [0, 1, 0.5 * height], [0, 0, 1]])
    return middle @ np.diag([zoom, zoom, 1.0]) @ np.linalg.inv(middle) @ K


def _seen(K: np.ndarray, lens_K: np.ndarray, distortion: np.ndarray, fisheye: bool, width: int, height: int) -> float | None:
    """Share of the lens's picture that the pinhole camera K shows. None if some pixel would have no data: it lies outside the picture, or
    beyond the radius at which the distortion folds the picture over."""
    across, down = max(width - 1, 1), max(height - 1, 1)
    # the first and last grid points are the centres of the first and last pixels
    grid = np.array([[(GRID - 1) / across, 0, -0.5 * (GRID - 1) / across], [0, (GRID - 1) / down, -0.5 * (GRID - 1) / down], [0, 0, 1]])
    x, y = (one.astype(np.float64) for one in _maps(grid @ K, lens_K, distortion, fisheye, GRID, GRID))
    # a pixel extends half a pixel to all sides of its centre, so places up to the outer border are still in the picture
    if not ((x >= 0) & (x <= width) & (y >= 0) & (y <= height)).all():  # NaN is in no picture
        return None
    area = np.gradient(x, axis=1) * np.gradient(y, axis=0) - np.gradient(x, axis=0) * np.gradient(y, axis=1)
    return float(min(area.mean() * (GRID - 1) ** 2 / (across * down), 1.0)) if (area > 0).all() else None


def _maps(
    K: np.ndarray, lens_K: np.ndarray, distortion: np.ndarray, fisheye: bool, width: int, height: int
) -> tuple[np.ndarray, np.ndarray]:
    """x and y in the lens's picture, float32 [height, width] each, of each pixel of K's, counted from 0. Both K use the same convention."""
    import cv2

    terms = np.asarray(distortion, np.float64)
    if fisheye:
        return cv2.fisheye.initUndistortRectifyMap(lens_K, terms[:4], np.eye(3), K, (width, height), cv2.CV_32FC1)  # type: ignore[return-value]
    return cv2.initUndistortRectifyMap(lens_K, terms, None, K, (width, height), cv2.CV_32FC1)  # type: ignore[call-overload, return-value]
