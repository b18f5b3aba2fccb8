"""Flicker: how much more a render changes from one time to the next than the scene does, seen from a fixed camera."""

from __future__ import annotations

from collections.abc import Iterable

import cv2
import numpy as np

from ..edges import edge_mask_canny, near_edges
from .edge_psnr import PIXELS
from .images import as_pair

STEADY = 0.01  # standard deviation over time, for values in [0, 1], below which the truth counts as static
LEVELS = 255.0  # changes are reported in levels of 8-bit images
MOVES = 0.5  # px between neighbouring times; where the truth moves by less, it does not count as moving
AGREES = 1.0  # px by which the truth's flow may miss its starting point on the way back, if it is trusted
MEASURES = ("static", "edges", "warped", "flow")
FARNEBACK = {"pyr_scale": 0.5, "levels": 3, "winsize": 15, "iterations": 3, "poly_n": 5, "poly_sigma": 1.2, "flags": 0}


def steady_pixels(truths: Iterable[np.ndarray]) -> np.ndarray:
    """Where images of one camera, float [H, W, 3] in [0, 1], deviate over time by less than `STEADY` in every channel: bool [H, W].

    Raises ValueError if there is no image.
    """
    count, mean, squares = 0, np.zeros(()), np.zeros(())
    for truth in truths:  # Welford's algorithm: a difference of large squares would lose precision
        count += 1
        gap = np.asarray(truth, np.float64) - mean
        mean = mean + gap / count
        squares = squares + gap * (truth - mean)
    if not count:
        raise ValueError("truths: there is no picture")
    return np.asarray((np.sqrt(squares / count) < STEADY).all(-1))


class Flicker:
    """Measures flicker between neighbouring times, for one or more fixed cameras.

    The excess of a pixel is max(0, |R(t+1) - R(t)| - |Y(t+1) - Y(t)|) in 8-bit levels, where R is the render, Y the truth and | | the mean
    over channels. `static` is its mean over pixels where the truth is steady, and `edges` its mean within 2 px of an edge of the truth.
    `warped` is the excess warping error (Lai et al. 2018): the same excess with R(t+1) and Y(t+1) looked up where the truth's optical flow
    leads, as the mean over pixels where the truth moves and the next time shows the same surface.
    `flow` is the mean distance in px between optical flow measured in the renders and in the truth (tOF, Chu et al. 2020, with Farneback's
    flow). `rows` has all four (`MEASURES`) for each pair of times, None if the pair has no such pixel. A render that equals the truth has
    0 everywhere.
    """

    def __init__(self) -> None:
        self.rows: list[dict[str, float | None]] = []
        self._before: tuple[np.ndarray, np.ndarray] | None = None
        self._steady: np.ndarray | None = None

    def begin(self, steady: np.ndarray) -> None:
        """Start another camera; the next images are from it. steady: bool [H, W]."""
        self._steady, self._before = steady, None

    def add(self, render: np.ndarray, truth: np.ndarray) -> None:
        """Add the camera's next time; both images are float [H, W, 3] in [0, 1]. Raises ValueError if the shapes differ."""
        assert self._steady is not None, "begin() comes first"
        render, truth = as_pair(render, truth)
        before, self._before = self._before, (render, truth)
        if before is None:
            return
        excess = _excess(before, (render, truth))
        near = near_edges(edge_mask_canny(_bytes(truth)), PIXELS)
        flow, back = _flow(before[1], truth), _flow(truth, before[1])
        along = _excess(before, (_look_up(render, flow), _look_up(truth, flow)))
        self.rows.append(
            {
                "static": _mean(excess, self._steady),
                "edges": _mean(excess, near),
                "warped": _mean(along, _moves(flow, back)),
                "flow": float(np.linalg.norm(_flow(before[0], render) - flow, axis=-1).mean()),
            }
        )

    def means(self) -> dict[str, float | None]:
        """Each of `MEASURES` as the mean over pairs; None if no pair has such pixels."""
        found = {name: [value for row in self.rows if (value := row[name]) is not None] for name in MEASURES}
        return {name: float(np.mean(values)) if values else None for name, values in found.items()}


def _excess(first: tuple[np.ndarray, np.ndarray], second: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """By how many levels the render changes more than the truth; both are (render, truth). [H, W]."""
    changes = [np.abs(later - sooner).mean(-1) for sooner, later in zip(first, second)]
    return np.asarray(LEVELS * np.maximum(0.0, changes[0] - changes[1]))


def _mean(values: np.ndarray, mask: np.ndarray) -> float | None:
    return float(values[mask].mean()) if mask.any() else None


def _look_up(image: np.ndarray, flow: np.ndarray) -> np.ndarray:
    """``image`` [H, W, 3] at each pixel's position plus ``flow`` [H, W, 2] px, bilinear."""
    x, y = _places(flow)
    return cv2.remap(image.astype(np.float32), x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)


def _places(flow: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    height, width = flow.shape[:2]
    x, y = np.meshgrid(np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32))
    return x + flow[..., 0], y + flow[..., 1]


def _moves(flow: np.ndarray, back: np.ndarray) -> np.ndarray:
    """bool [H, W]: pixels that move and that the next time shows, too: inside the image, and ``back`` leads back to them."""
    height, width = flow.shape[:2]
    x, y = _places(flow)
    inside = (x >= 0) & (x <= width - 1) & (y >= 0) & (y <= height - 1)
    missed = np.linalg.norm(flow + cv2.remap(back, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE), axis=-1)
    return np.asarray(inside & (missed <= AGREES) & (np.linalg.norm(flow, axis=-1) >= MOVES))


def _bytes(image: np.ndarray) -> np.ndarray:
    return np.rint(np.clip(image, 0.0, 1.0) * LEVELS).astype(np.uint8)


def _flow(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    greys = [cv2.cvtColor(_bytes(image), cv2.COLOR_RGB2GRAY) for image in (first, second)]
    return cv2.calcOpticalFlowFarneback(greys[0], greys[1], None, **FARNEBACK)  # type: ignore[call-overload]
