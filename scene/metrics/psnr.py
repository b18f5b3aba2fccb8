"""Peak signal-to-noise ratio, and an affine colour fit: captures with several cameras also report PSNR after this fit."""

from __future__ import annotations

import math

import numpy as np

from .images import as_pair

CAP = 100.0  # dB, the value for identical images, so that means over views stay finite


def psnr(image: np.ndarray, truth: np.ndarray, mask: np.ndarray | None = None) -> float:
    """-10 log10(mean squared error) in dB, over all channels of all pixels or of those in ``mask`` (bool [H, W]); at most `CAP`.

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
    return decibels(float(error.mean()))


def decibels(mse: float) -> float:
    """PSNR in dB of a mean squared error of colours in [0, 1]; at most `CAP`."""
    return CAP if mse <= 10 ** (-CAP / 10) else -10.0 * math.log10(mse)


def affine_fit(image: np.ndarray, truth: np.ndarray, mask: np.ndarray | None = None) -> np.ndarray:
    """``image`` after the per-channel gain and offset that fit it best to ``truth`` (least squares), clamped to [0, 1].

    The cameras of a rig differ in gain and offset, and a model cannot know those of a camera it never saw. A channel without variation
    gets an offset only. float [H, W, 3] in, float64 [H, W, 3] out. mask: bool [H, W], the pixels used for the fit; all if None.
    """
    image, truth = as_pair(image, truth)
    near, goal = (image.reshape(-1, 3), truth.reshape(-1, 3)) if mask is None else (image[mask], truth[mask])
    mean, target = near.mean(0), goal.mean(0)
    centred = image - mean
    variance = np.square(near - mean).mean(0)
    covariance = ((near - mean) * (goal - target)).mean(0)
    gain = np.divide(covariance, variance, out=np.zeros(3), where=variance > 1e-12)
    return np.clip(centred * gain + target, 0.0, 1.0)
