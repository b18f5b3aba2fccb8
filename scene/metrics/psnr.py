"""Peak signal-to-noise ratio, and the affine colour fit after which it is also reported for captures of several cameras."""

from __future__ import annotations

import math

import numpy as np

from .images import as_pair

CAP = 100.0  # dB, the answer for identical images: a mean over views stays a number


def psnr(image: np.ndarray, truth: np.ndarray, mask: np.ndarray | None = None) -> float:
    """-10 log10(mean squared error) in dB over all channels of all pixels, or of those in ``mask`` (bool [H, W]); at most `CAP`.

    image, truth: float [H, W, 3] in [0, 1]. Raises ValueError for other shapes, non-finite values or an empty mask.
    """
    image, truth = as_pair(image, truth)
    error = np.square(image - truth)
    if mask is not None:
        if mask.shape != error.shape[:2] or mask.dtype != bool:
            raise ValueError(f"mask: expected bool {list(error.shape[:2])}, got {mask.dtype} {list(mask.shape)}")
        if not mask.any():
            raise ValueError("mask: holds no pixel, so there is nothing to compare")
        error = error[mask]
    mse = float(error.mean())
    return CAP if mse <= 10 ** (-CAP / 10) else -10.0 * math.log10(mse)


def affine_fit(image: np.ndarray, truth: np.ndarray, mask: np.ndarray | None = None) -> np.ndarray:
    """``image`` after the per-channel gain and offset that bring it closest to ``truth`` (least squares), clamped to [0, 1].

    Cameras of one rig differ in gain and offset; a novel view cannot know those of a camera it never saw. A channel without variation
    gets an offset only. float [H, W, 3] in, float64 [H, W, 3] out. mask: bool [H, W], the pixels that are brought close; all without one.
    """
    image, truth = as_pair(image, truth)
    near, goal = (image.reshape(-1, 3), truth.reshape(-1, 3)) if mask is None else (image[mask], truth[mask])
    mean, target = near.mean(0), goal.mean(0)
    centred = image - mean
    variance = np.square(near - mean).mean(0)
    covariance = ((near - mean) * (goal - target)).mean(0)
    gain = np.divide(covariance, variance, out=np.zeros(3), where=variance > 1e-12)
    return np.clip(centred * gain + target, 0.0, 1.0)
