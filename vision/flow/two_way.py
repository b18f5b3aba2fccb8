"""Flow between two pictures in both directions, and how far it can be trusted: forward-backward consistency and occlusion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..warp import places, warped
from .method import Dis, FlowMethod, Prepared, Preset
from .outlines import sharpened

COVERED = 0.65  # share of the density of arrivals that the flow's own stretch explains; where fewer arrive, the pixel is hidden
SMOOTH = 1.0  # px, smoothing of the density: flow is not exact to a pixel at outlines
AROUND = 25  # px, side of the window whose median is the local stretch; hidden bands are thinner than half of it


@dataclass(frozen=True)
class FlowPair:
    """forward, backward [H, W, 2] float32 px (u right, v down); backward starts at the second picture's pixels. confidence [H, W] uint8."""

    forward: np.ndarray
    backward: np.ndarray
    confidence: np.ndarray


def both_ways(method: FlowMethod, first: Prepared, second: Prepared) -> tuple[np.ndarray, np.ndarray]:
    """Flow forward and backward, [H, W, 2] float32 px each, `sharpened` at outlines."""
    forward = sharpened(method.flow(first, second), first.picture, second.picture)
    return forward, sharpened(method.flow(second, first), second.picture, first.picture)


def trusted(forward: np.ndarray, backward: np.ndarray, device: str = "cpu") -> FlowPair:
    """Both flows, [H, W, 2] float32 px, with the confidence in the forward flow: `consistency`, 0 where `occluded`."""
    confidence = consistency(forward, backward, device)
    confidence[occluded(forward, backward)] = 0
    return FlowPair(forward, backward, confidence)


def dis_flow(first: np.ndarray, second: np.ndarray, preset: Preset = "medium") -> np.ndarray:
    """Flow [H, W, 2] float32 px between two pictures uint8 [H, W, 3] RGB by `Dis`."""
    method = Dis(preset)
    return method.flow(method.prepare(first), method.prepare(second))


def consistency(forward: np.ndarray, backward: np.ndarray, device: str = "cpu") -> np.ndarray:
    """How closely ``backward`` returns to the start of ``forward``, both [H, W, 2] float32: uint8 [H, W], 255 consistent, 0 not.

    The squared error is e = |f + b(x + f)|^2, and the tolerance is 0.01 (|f|^2 + |b|^2) + 0.5 px^2 (Sundaram et al. 2010). The weight is 1
    up to a quarter of the tolerance and falls linearly to 0 at the tolerance. Pixels that leave the picture get 0.
    """
    if device != "cpu":
        from . import on_gpu

        return on_gpu.consistency(forward, backward, device)
    import cv2

    back = warped(backward, forward)
    error, (fu, fv), (bu, bv) = forward + back, cv2.split(forward), cv2.split(back)
    tolerance = 0.01 * (fu * fu + fv * fv + bu * bu + bv * bv) + 0.5
    error = error[..., 0] ** 2 + error[..., 1] ** 2
    weight = np.clip((1.0 - error / tolerance) * (255.0 / 0.75), 0.0, 255.0)
    weight[_outside(*places(forward))] = 0.0
    return np.rint(weight).astype(np.uint8)


def occluded(forward: np.ndarray, backward: np.ndarray) -> np.ndarray:
    """Pixels of the first picture that the second does not show: bool [H, W], from both flows [H, W, 2] float32.

    The backward flow sends each pixel of the second picture to a place in the first. Pixels of the first picture at which none arrive are
    hidden in the second (the range map of Wang et al. 2018). Arrivals are spread bilinearly, smoothed, and compared with the density that
    the local stretch of the forward flow predicts. This matters when the camera moves back: the second picture then shows all of the first
    in fewer pixels, and nothing is hidden. Pixels that leave the picture count as occluded too. The disagreement of the two flows would
    give many more false alarms, since errors of either flow cause it as well; so would the failure of a match. Smeared flow fills narrow
    hidden bands, so `both_ways` sharpens it first.
    """
    import cv2

    arrivals = cv2.GaussianBlur(_arrivals(backward), (0, 0), SMOOTH, borderType=cv2.BORDER_REPLICATE)
    return _outside(*places(forward)) | (arrivals < COVERED * np.minimum(_stretch(forward), 1.0))


def _stretch(flow: np.ndarray) -> np.ndarray:
    """Pixels of the second picture for each pixel of the first, as a local median: float32 [H, W]; 1 where the flow is not finite."""
    import cv2

    if min(flow.shape[:2]) < 2:
        return np.ones(flow.shape[:2], np.float32)
    (uy, ux), (vy, vx) = (np.gradient(np.clip(np.nan_to_num(flow[..., k]), -1e6, 1e6)) for k in range(2))
    stretch = np.clip(((1 + ux) * (1 + vy) - uy * vx) * 100, 0, 255)
    return cv2.medianBlur(np.rint(stretch).astype(np.uint8), AROUND).astype(np.float32) / 100


def _arrivals(backward: np.ndarray) -> np.ndarray:
    """How many pixels of the second picture the backward flow sends to each pixel of the first, float32 [H, W], shared bilinearly."""
    from .. import _kernels  # type: ignore[attr-defined]

    out = np.empty(backward.shape[:2], np.float32)
    _kernels.arrivals(np.ascontiguousarray(backward, np.float32), out)
    return out


def _outside(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    height, width = x.shape
    return (x < 0) | (x > width - 1) | (y < 0) | (y > height - 1)
