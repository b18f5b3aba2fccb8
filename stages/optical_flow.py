"""Measured optical flow of two pictures (OpenCV DIS) and how far it may be trusted (forward-backward consistency)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

Preset = Literal["ultrafast", "fast", "medium"]
MINIMUM_SIDE = 64  # px; DIS reads outside its buffers on thin pictures (found at sides below 32), so smaller ones are padded


@dataclass(frozen=True)
class FlowPair:
    """forward, backward [H, W, 2] float32 px (u right, v down); backward is seen from the second picture. confidence [H, W] uint8."""

    forward: np.ndarray
    backward: np.ndarray
    confidence: np.ndarray


def dis_flow(first: np.ndarray, second: np.ndarray, preset: Preset = "medium", max_size: int | None = None) -> np.ndarray:
    """Flow [H, W, 2] float32 px from ``first`` to ``second``, both uint8 [H, W, 3] RGB: pixel (x, y) of first is at (x+u, y+v) in second.

    max_size: longest side at which flow is computed; larger pictures are scaled down by area and the flow is scaled up again. The result
    does not depend on the number of threads. Raises ValueError for other shapes or dtypes.
    """
    import cv2

    for name, image in (("first", first), ("second", second)):
        if image.ndim != 3 or image.shape[2] != 3 or image.dtype != np.uint8 or image.size == 0:
            raise ValueError(f"{name}: expected uint8 [H, W, 3] with H, W > 0, got {image.dtype} {list(image.shape)}")
    if first.shape != second.shape:
        raise ValueError(f"first {list(first.shape)} and second {list(second.shape)} differ in shape")
    height, width = first.shape[:2]
    greys = [cv2.cvtColor(np.ascontiguousarray(image), cv2.COLOR_RGB2GRAY) for image in (first, second)]
    small = _size_within(width, height, max_size)
    if small != (width, height):
        greys = [cv2.resize(grey, small, interpolation=cv2.INTER_AREA) for grey in greys]
    right, below = max(0, MINIMUM_SIDE - small[0]), max(0, MINIMUM_SIDE - small[1])
    if right or below:
        greys = [cv2.copyMakeBorder(grey, 0, below, 0, right, cv2.BORDER_REPLICATE) for grey in greys]
    presets = {
        "ultrafast": cv2.DISOPTICAL_FLOW_PRESET_ULTRAFAST,
        "fast": cv2.DISOPTICAL_FLOW_PRESET_FAST,
        "medium": cv2.DISOPTICAL_FLOW_PRESET_MEDIUM,
    }
    flow = cv2.DISOpticalFlow.create(presets[preset]).calc(greys[0], greys[1], None)  # type: ignore[call-overload]
    flow = flow[: small[1], : small[0]]
    if small != (width, height):
        flow = cv2.resize(flow, (width, height), interpolation=cv2.INTER_LINEAR)
        flow *= np.array([width / small[0], height / small[1]], np.float32)
    return np.ascontiguousarray(flow, np.float32)


def _size_within(width: int, height: int, max_size: int | None) -> tuple[int, int]:
    if max_size is None or max(width, height) <= max_size:
        return width, height
    scale = max_size / max(width, height)
    return max(1, round(width * scale)), max(1, round(height * scale))


def consistency(forward: np.ndarray, backward: np.ndarray) -> np.ndarray:
    """How well ``backward`` leads back to where ``forward`` came from, both [H, W, 2] float32: uint8 [H, W], 255 consistent, 0 not.

    With e = |f + b(x + f)|^2 and the tolerance 0.01 (|f|^2 + |b|^2) + 0.5 px^2 of Sundaram et al. 2010, the weight is 1 up to a quarter of
    the tolerance and falls linearly to 0 at the tolerance. Pixels that leave the picture get 0.
    """
    import cv2

    height, width = forward.shape[:2]
    to_x = forward[..., 0] + np.arange(width, dtype=np.float32)
    to_y = forward[..., 1] + np.arange(height, dtype=np.float32)[:, None]
    back = cv2.remap(backward, to_x, to_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    error, (fu, fv), (bu, bv) = forward + back, cv2.split(forward), cv2.split(back)
    tolerance = 0.01 * (fu * fu + fv * fv + bu * bu + bv * bv) + 0.5
    error = error[..., 0] ** 2 + error[..., 1] ** 2
    weight = np.clip((1.0 - error / tolerance) * (255.0 / 0.75), 0.0, 255.0)
    weight[(to_x < 0) | (to_x > width - 1) | (to_y < 0) | (to_y > height - 1)] = 0.0
    return np.rint(weight).astype(np.uint8)


def flow_pair(first: np.ndarray, second: np.ndarray, preset: Preset = "medium", max_size: int | None = None) -> FlowPair:
    """Flow both ways and its confidence, for two pictures uint8 [H, W, 3] RGB. See `dis_flow`."""
    forward, backward = dis_flow(first, second, preset, max_size), dis_flow(second, first, preset, max_size)
    return FlowPair(forward, backward, consistency(forward, backward))
