"""Corrects flow beside outlines, where every method smears it: each pixel may take the flow of a pixel a few px away."""

from __future__ import annotations

import numpy as np

from ..warp import sampled

AWAY = ((3, 0), (-3, 0), (0, 3), (0, -3), (6, 6), (-6, 6), (6, -6), (-6, -6))  # px; flow is smeared over about this far, in any direction
BETTER = 3  # grey levels by which another flow must match better; rounding to 8 bits and interpolation change a match by less
LARGEST = 40  # grey levels; a pixel that matches worse is hidden or another surface, and how much worse carries no information
SMOOTH = 0.7  # px, smoothing of the mismatch: about 3x3 pixels decide, few enough to tell the two sides of an outline apart
STEP = 4  # px; a sixteenth of the pixels is enough to measure the change of brightness between the pictures
UNITS = 4  # steps per grey level in which mismatches are stored in 8 bits


def sharpened(flow: np.ndarray, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Flow [H, W, 2] float32 px from first to second, uint8 [H, W, 3]; a pixel takes a nearby pixel's flow if that matches clearly better.

    This is the propagation step of PatchMatch (Barnes et al. 2009), applied to a measured flow: a pixel on the wrong side of a smeared
    outline finds the flow of its own surface a few px away. Away from outlines, neighbouring pixels have the same flow, and nothing
    changes. Raises ValueError if shapes differ.
    """
    import cv2

    height, width = flow.shape[:2]
    if first.shape != (height, width, 3) or second.shape != first.shape:
        raise ValueError(f"first {list(first.shape)}, second {list(second.shape)}: expected [{height}, {width}, 3] like the flow")
    reach = max(max(abs(dx), abs(dy)) for dx, dy in AWAY)
    x, y = np.meshgrid(np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32))
    u, v = (cv2.copyMakeBorder(flow[..., k], reach, reach, reach, reach, cv2.BORDER_REPLICATE) for k in range(2))

    def seen(dx: int, dy: int) -> np.ndarray:
        """The second picture, sampled where the flow of the pixel (dx, dy) away leads."""
        rows, columns = slice(reach + dy, reach + dy + height), slice(reach + dx, reach + dx + width)
        return sampled(second, u[rows, columns] + x, v[rows, columns] + y)

    own = seen(0, 0)
    change = np.median(own[::STEP, ::STEP].astype(np.int16) - first[::STEP, ::STEP], axis=(0, 1))
    if np.rint(change).any():
        first = np.clip(first + np.rint(change), 0, 255).astype(np.uint8)

    def mismatch(shown: np.ndarray) -> np.ndarray:
        """uint8 [H, W], `UNITS` steps per grey level: the difference in the channel that differs most."""
        red, green, blue = cv2.split(cv2.absdiff(shown, first))
        most = np.minimum(np.maximum(np.maximum(red, green), blue), np.uint8(LARGEST))
        return cv2.GaussianBlur(most * np.uint8(UNITS), (0, 0), SMOOTH, borderType=cv2.BORDER_REPLICATE)

    least = np.maximum(mismatch(own), np.uint8(UNITS * BETTER)) - np.uint8(UNITS * BETTER)
    taken = np.zeros((height, width), np.uint8)
    for k, (dx, dy) in enumerate(AWAY):
        there = mismatch(seen(dx, dy))
        np.copyto(taken, k + 1, where=there < least)
        least = np.minimum(least, there)
    stride = width + 2 * reach
    steps = np.array([0, *(dy * stride + dx for dx, dy in AWAY)])
    places = (np.arange(height)[:, None] + reach) * stride + np.arange(width) + reach + steps[taken]
    return np.stack([u.ravel()[places], v.ravel()[places]], axis=-1)
