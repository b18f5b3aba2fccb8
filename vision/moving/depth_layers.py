"""Tells apart things that move and touch in the picture, by the steps of depth between them."""

from __future__ import annotations

import cv2
import numpy as np

STEP = 0.15  # least difference of the logarithms of depth within `REACH` that is a step: within one thing it rarely changes as fast
FAR = np.float32(1e4)  # beyond all logarithms of depth
REACH = 0.025  # of the picture's width: over this much a network's depth blurs a step


def depth_layers(mask: np.ndarray, inside: np.ndarray, z: np.ndarray, least: int) -> np.ndarray:
    """[h, w] int32: for the pixels of each connected part of ``mask`` [h, w] bool numbers from 1, equal where no step of the depth ``z``
    [h, w] lies between them; 0 elsewhere. inside: [h, w] bool, where depth is that of what moves. least: pixels on either side of steps
    that make a thing of its own; all other pixels of a part join the nearest thing. z is 0 where it is unknown."""
    count, labels = cv2.connectedComponents(mask.astype(np.uint8), connectivity=8)
    known = inside & mask & (z > 0)
    log = np.log(np.where(known, z, 1.0)).astype(np.float32)
    window = np.ones((max(3, round(REACH * mask.shape[1]) | 1),) * 2, np.uint8)
    highest, lowest = cv2.dilate(np.where(known, log, -FAR), window), cv2.erode(np.where(known, log, FAR), window)
    smooth = known & (highest - lowest < STEP)
    things, pieces, stats, _ = cv2.connectedComponentsWithStats(smooth.astype(np.uint8), connectivity=4)
    large = np.isin(np.arange(things), 1 + np.flatnonzero(stats[1:, cv2.CC_STAT_AREA] >= least))
    result = labels.astype(np.int32)
    for part in range(1, count):
        here = labels == part
        own = np.where(here & large[pieces], pieces, 0)
        found = np.unique(own[own > 0])
        if len(found) > 1:
            nearest = np.searchsorted(found, _nearest(own)[here])
            result[here] = np.where(nearest > 0, count + nearest - 1, part)
            count += len(found) - 1
    return result


def _nearest(own: np.ndarray) -> np.ndarray:
    """[h, w]: ``own`` of the nearest pixel that has any."""
    _, nearest = cv2.distanceTransformWithLabels((own == 0).astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL)
    number = np.zeros(int(nearest.max()) + 1, own.dtype)
    number[nearest[own > 0]] = own[own > 0]
    return number[nearest]
