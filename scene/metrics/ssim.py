"""Structural similarity (Wang et al. 2004), with the usual constants."""

from __future__ import annotations

import cv2
import numpy as np

from .images import as_pair

WINDOW, SIGMA = 11, 1.5
C1, C2 = 0.01**2, 0.03**2


def ssim_map(image: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """SSIM at each pixel and channel, float64 [H, W, 3].

    Gaussian window of 11 x 11 px, sigma 1.5, normalised to 1; zero padding, as in radiance-field papers (the window is not renormalised at
    the border); moments without Bessel's correction. Defined for every size from 1 x 1.
    """
    x, y = as_pair(image, truth)
    taps = cv2.getGaussianKernel(WINDOW, SIGMA, cv2.CV_64F)

    def blur(a: np.ndarray) -> np.ndarray:
        return cv2.sepFilter2D(a, cv2.CV_64F, taps, taps, borderType=cv2.BORDER_CONSTANT)

    mx, my = blur(x), blur(y)
    vx, vy, vxy = blur(x * x) - mx * mx, blur(y * y) - my * my, blur(x * y) - mx * my
    return ((2 * mx * my + C1) * (2 * vxy + C2)) / ((mx * mx + my * my + C1) * (vx + vy + C2))


def ssim(image: np.ndarray, truth: np.ndarray, mask: np.ndarray | None = None) -> float:
    """Mean of `ssim_map` over pixels and channels, in [-1, 1]. image, truth: float [H, W, 3] in [0, 1]. mask: bool [H, W], the pixels that
    count; all if None."""
    found = ssim_map(image, truth)
    return float(found.mean() if mask is None else found[mask].mean())
