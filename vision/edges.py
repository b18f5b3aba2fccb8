"""Edge weights of a frame of a video: edges of the picture that its neighbours in time confirm, and boundaries of motion."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

BOUNDARY = (0.5, 1.5)  # px of flow from one pixel to the next: no boundary of motion up to the first, a full one from the second on


class Seen(NamedTuple):
    """A frame's edges as a neighbour in time has them, in the frame's own pixels: `weight` uint8 [H, W], how far each may be trusted
    `confidence` uint8 [H, W], and `boundary` uint8 [H, W], where the flow to that neighbour breaks."""

    weight: np.ndarray
    confidence: np.ndarray
    boundary: np.ndarray


def seen_by(neighbour: np.ndarray, flow: np.ndarray, confidence: np.ndarray) -> Seen:
    """What a neighbour's edge weights (uint8 [H, W]) are in this frame, whose flow to the neighbour is ``flow`` [H, W, 2] px."""
    import cv2

    height, width = neighbour.shape
    to_x = flow[..., 0] + np.arange(width, dtype=np.float32)
    to_y = flow[..., 1] + np.arange(height, dtype=np.float32)[:, None]
    weight = cv2.remap(neighbour, to_x, to_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return Seen(weight, confidence, motion_boundaries(flow, confidence))


def motion_boundaries(flow: np.ndarray, confidence: np.ndarray) -> np.ndarray:
    """Where ``flow`` [H, W, 2] px breaks: uint8 [H, W], 255 where it changes by 1.5 px and more from a pixel to the next.

    Only breaks that touch a pixel of full ``confidence`` (uint8 [H, W]) count: one side of an outline is measured well even where the
    other is hidden, while flow that is wrong altogether breaks anywhere.
    """
    import cv2

    smooth = cv2.GaussianBlur(flow, (0, 0), 1.0, borderType=cv2.BORDER_REPLICATE)
    across, down = (
        cv2.Sobel(smooth, cv2.CV_32F, *order, ksize=3, scale=1 / 8, borderType=cv2.BORDER_REPLICATE) for order in ((1, 0), (0, 1))
    )
    # A break of h px, spread by the blur over some two and a half pixels, has a slope of 0.3 h.
    change = np.sqrt((across**2 + down**2).sum(-1)) / 0.3
    low, high = BOUNDARY
    trusted = cv2.dilate((confidence == 255).astype(np.uint8), np.ones((3, 3), np.uint8))
    return np.rint(255 * np.clip((change - low) / (high - low), 0, 1)).astype(np.uint8) * trusted


def stable_edges(own: np.ndarray, neighbours: Sequence[Seen]) -> np.ndarray:
    """Edge weights uint8 [H, W] of a frame from its ``own`` (uint8 [H, W]) and what its neighbours in time see.

    The mean of all that are trusted: an edge that noise makes and unmakes from frame to frame keeps half of its weight in each, instead
    of all and nothing. Boundaries of motion count in full.
    """
    total, count = own.astype(np.float32), np.ones(own.shape, np.float32)
    boundary = np.zeros(own.shape, np.uint8)
    for seen in neighbours:
        share = seen.confidence.astype(np.float32) / 255
        total += share * seen.weight
        count += share
        boundary = np.maximum(boundary, seen.boundary)
    return np.maximum(np.rint(total / count).astype(np.uint8), boundary)
