"""Flow as colours: the Middlebury colour wheel (Baker et al. 2011, "A Database and Evaluation Methodology for Optical Flow")."""

from __future__ import annotations

import math

import numpy as np

# Where each pure colour lies on the wheel of 55 hues: 15 steps from red to yellow, then 6 to green, 4 to cyan, 11 to blue, 13 to magenta
# and 6 back to red. Channels are interpolated linearly in between.
HUES = 55
CORNERS = (0, 15, 21, 25, 36, 49, HUES)
CHANNELS = (
    (1.0, 1.0, 0.0, 0.0, 0.0, 1.0, 1.0),
    (0.0, 1.0, 1.0, 1.0, 0.0, 0.0, 0.0),
    (0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 0.0),
)
DARKER = 0.75  # factor on colours of vectors longer than `largest`
UNKNOWN = 1e9  # px; Middlebury marks unknown vectors with components beyond this
SHORTEST = 0.5  # px; `typical_largest` ignores shorter vectors


def flow_colours(flow: np.ndarray, largest: float | None = None) -> np.ndarray:
    """Colours uint8 [H, W, 3] RGB of ``flow``, float [H, W, 2] px (u right, v down).

    The hue is the direction (red right, yellow down, cyan left, blue up, blended in between). The saturation is the length divided by
    ``largest`` px: no motion is white, `largest` has full colour, and longer vectors are darkened. Black is unknown: not finite, or a
    component beyond 1e9. largest=None takes `typical_largest`. The original wheel has a seam; here the last hue blends into the first, so
    that motion to the right does not flicker between two reds. Raises ValueError for another shape or dtype, or a `largest` that is not a
    positive number.
    """
    known, u, v = _split(flow)
    if largest is None:
        largest = typical_largest(flow)
    if not (math.isfinite(largest) and largest > 0):
        raise ValueError(f"largest: expected a positive number of px, got {largest}")
    length = np.hypot(u, v) / largest
    hue = np.arctan2(v, u) * (HUES / (2 * math.pi)) % HUES
    colours = np.empty((*hue.shape, 3), np.uint8)
    beyond = length > 1
    for channel, values in enumerate(CHANNELS):
        pure = np.interp(hue, CORNERS, values)
        shade = np.where(beyond, DARKER * pure, 1 - length * (1 - pure))
        colours[..., channel] = np.rint(255 * np.clip(shade, 0, 1))
    colours[~known] = 0
    return colours


def typical_largest(*flows: np.ndarray) -> float:
    """The length in px that gets full colour: the 99th percentile over all vectors of ``flows`` (float [H, W, 2] each), at least 1 px.

    Unknown vectors and those shorter than half a pixel are left out. Otherwise a small object moving in front of a static background, which
    is what people look for in flow, would be out of range everywhere. The floor of 1 px keeps noise pale where nothing moves.
    """
    lengths = []
    for flow in flows:
        known, u, v = _split(flow)
        length = np.hypot(u, v)
        lengths.append(length[known & (length >= SHORTEST)])
    moving = np.concatenate(lengths) if lengths else np.empty(0)
    return max(1.0, float(np.percentile(moving, 99))) if moving.size else 1.0


def colour_wheel(size: int) -> np.ndarray:
    """The legend: uint8 [size, size, 3], each pixel in the colour of the vector from the centre to it; white outside the circle."""
    across = (np.arange(size) + 0.5) / size * 2 - 1
    vectors = np.stack(np.meshgrid(across, across), axis=-1)
    colours = flow_colours(vectors, 1.0)
    colours[np.hypot(vectors[..., 0], vectors[..., 1]) > 1] = 255
    return colours


def _split(flow: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Which vectors are known (bool [H, W]), and u and v with zeros where they are not."""
    if flow.ndim != 3 or flow.shape[2] != 2 or not np.issubdtype(flow.dtype, np.floating):
        raise ValueError(f"flow: expected float [H, W, 2], got {flow.dtype} {list(flow.shape)}")
    # Two float32 planes: half floats are slow, and strided access is slower still. NaN compares false and so counts as unknown.
    u, v = (flow[..., k].astype(np.float32) for k in range(2))
    known = (np.abs(u) <= UNKNOWN) & (np.abs(v) <= UNKNOWN)
    return known, np.where(known, u, np.float32(0)), np.where(known, v, np.float32(0))
