"""Edge weights for a video frame: image edges that the neighbouring frames confirm, and motion boundaries."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from .warp import warped

BOUNDARY = (0.5, 1.5)  # px, change of flow between adjacent pixels: no motion boundary up to the first, full weight from the second on


class Seen(NamedTuple):
    """A neighbouring frame's edges, warped to this frame's pixels: `weight` uint8 [H, W]; `confidence` uint8 [H, W], how far each weight
    can be trusted; and `boundary` uint8 [H, W], where the flow to that neighbour is discontinuous."""

    weight: np.ndarray
    confidence: np.ndarray
    boundary: np.ndarray


def seen_by(neighbour: np.ndarray, flow: np.ndarray, confidence: np.ndarray, device: str = "cpu") -> Seen:
    """Warps a neighbour's edge weights (uint8 [H, W]) to this frame. ``flow`` [H, W, 2] px leads from this frame to the neighbour."""
    return Seen(warped(neighbour, flow, device), confidence, motion_boundaries(flow, confidence, device))


def motion_boundaries(flow: np.ndarray, confidence: np.ndarray, device: str = "cpu") -> np.ndarray:
    """Where ``flow`` [H, W, 2] px is discontinuous: uint8 [H, W], 255 where it changes by 1.5 px or more from one pixel to the next.

    Only discontinuities that touch a pixel of full ``confidence`` (uint8 [H, W]) count. At a real outline, one side is measured well even
    if the other is hidden; flow that is entirely wrong can be discontinuous anywhere.
    """
    if device != "cpu":
        from .flow import on_gpu

        return on_gpu.motion_boundaries(flow, confidence, BOUNDARY, device)
    import cv2

    smooth = cv2.GaussianBlur(flow, (0, 0), 1.0, borderType=cv2.BORDER_REPLICATE)
    across, down = (
        cv2.Sobel(smooth, cv2.CV_32F, *order, ksize=3, scale=1 / 8, borderType=cv2.BORDER_REPLICATE) for order in ((1, 0), (0, 1))
    )
    # The blur spreads a jump of h px over about two and a half pixels, which gives a slope of 0.3 h.
    change = np.sqrt((across**2 + down**2).sum(-1)) / 0.3
    low, high = BOUNDARY
    trusted = cv2.dilate((confidence == 255).astype(np.uint8), np.ones((3, 3), np.uint8))
    return np.rint(255 * np.clip((change - low) / (high - low), 0, 1)).astype(np.uint8) * trusted


def stable_edges(own: np.ndarray, neighbours: Sequence[Seen]) -> np.ndarray:
    """Edge weights uint8 [H, W] of a frame, from its ``own`` (uint8 [H, W]) and those of its neighbours in time.

    The result is the mean of all weights, each weighted by its confidence. An edge that flickers with noise from frame to frame then has
    half of its weight in each frame, instead of full weight in one and none in the next. Motion boundaries keep their full weight.
    """
    total, count = own.astype(np.float32), np.ones(own.shape, np.float32)
    boundary = np.zeros(own.shape, np.uint8)
    for seen in neighbours:
        share = seen.confidence.astype(np.float32) / 255
        total += share * seen.weight
        count += share
        boundary = np.maximum(boundary, seen.boundary)
    return np.maximum(np.rint(total / count).astype(np.uint8), boundary)
