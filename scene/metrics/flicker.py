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
    `flow` is the mean distance in px between optical flow measured in the renders and in the truth (tOF, Chu et al. 2020, with Farneback's
    flow). `rows` has all three for each pair of times, None if the pair has no such pixel.
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
        excess = LEVELS * np.maximum(0.0, np.abs(render - before[0]).mean(-1) - np.abs(truth - before[1]).mean(-1))
        edges = edge_mask_canny(_bytes(truth))
        masks = {"static": self._steady, "edges": near_edges(edges, PIXELS)}
        row = {name: float(excess[mask].mean()) if mask.any() else None for name, mask in masks.items()}
        row["flow"] = float(np.linalg.norm(_flow(before[0], render) - _flow(before[1], truth), axis=-1).mean())
        self.rows.append(row)

    def means(self) -> dict[str, float | None]:
        """`static`, `edges` and `flow`, each as the mean over pairs; None if no pair has such pixels."""
        found = {name: [value for row in self.rows if (value := row[name]) is not None] for name in ("static", "edges", "flow")}
        return {name: float(np.mean(values)) if values else None for name, values in found.items()}


def _bytes(image: np.ndarray) -> np.ndarray:
    return np.rint(np.clip(image, 0.0, 1.0) * LEVELS).astype(np.uint8)


def _flow(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    greys = [cv2.cvtColor(_bytes(image), cv2.COLOR_RGB2GRAY) for image in (first, second)]
    return cv2.calcOpticalFlowFarneback(greys[0], greys[1], None, **FARNEBACK)  # type: ignore[call-overload]
