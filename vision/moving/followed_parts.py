"""Tracks the connected parts of one camera's masks over time as objects, and measures how their apparent size changes.

A rigid object's depth is inversely proportional to its apparent size, so its depth in one frame determines it in all frames.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import cv2
import numpy as np

from ..flow.chain import Chain
from .depth_layers import depth_layers

PIXELS = 400  # most pixels of a part that are tracked to the next frame
FEWEST = 12  # least number of these that must be found again
PAIRS = 400  # pairs of pixels whose distances are compared
LEAST_AREA = 1e-3  # of the picture; smaller parts are noise of the mask
INSET = 0.01  # of the picture's width; masks extend beyond outlines by this much, onto what is behind and nearer floor


class Objects(NamedTuple):
    """labels: for each frame [h, w] uint8, the label of each pixel's part, 0 where nothing moves. They are smaller than the picture: `step`
    is the size of one of their pixels in picture pixels, in x and y. number: for each frame [labels] int, the object of each part, -1 for
    none. log_size: for each frame [labels], the logarithm of the ratio of the apparent size to that in the object's first frame."""

    labels: list[np.ndarray]
    step: tuple[float, float]
    number: list[np.ndarray]
    log_size: list[np.ndarray]

    def at(self, k: int, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Row and column in the labels of frame ``k`` for picture pixels ``x``, ``y``, with pixel centres at whole numbers."""
        height, width = self.labels[k].shape
        row, column = ((np.asarray(v) + 0.5) / s for v, s in ((y, self.step[1]), (x, self.step[0])))
        return np.clip(row.astype(int), 0, height - 1), np.clip(column.astype(int), 0, width - 1)


def follow_objects(chain: Chain, frames: int, depth: Mapping[int, np.ndarray] | None = None) -> Objects:
    """The connected parts of the masks of ``chain`` in its first ``frames`` frames, linked over time by flow. depth: [H, W] of some frames,
    0 where it is unknown, which tells things apart that touch in the picture."""
    rng = np.random.default_rng(0)
    labels = [_parts(chain.small_mask(k), (depth or {}).get(k)) for k in range(frames)]
    height, width = labels[0].shape
    objects = Objects(labels, (chain.width / width, chain.height / height), [], [])
    number = [np.full(int(of.max()) + 1, -1) for of in labels]
    log_size = [np.zeros(len(n)) for n in number]
    count = 0
    for k in range(frames):
        claims = _claims(chain, objects, k - 1, rng) if k else []
        for _, before, now, growth in sorted(claims, reverse=True):
            taken = number[k - 1][before] in number[k]
            if number[k][now] < 0 and not taken:
                number[k][now] = number[k - 1][before]
                log_size[k][now] = log_size[k - 1][before] + growth
        for part in range(1, len(number[k])):
            if number[k][part] < 0:
                number[k][part], count = count, count + 1
    return objects._replace(number=number, log_size=log_size)


def _parts(mask: np.ndarray, depth: np.ndarray | None = None) -> np.ndarray:
    """[h, w] uint8: labels 1, 2, ... of the connected parts of ``mask`` [h, w] bool, without noise and at most 255 parts; 0 elsewhere."""
    if depth is None:
        count, labels = cv2.connectedComponents(mask.astype(np.uint8), connectivity=8)
    else:
        z = cv2.resize(depth, (mask.shape[1], mask.shape[0]), interpolation=cv2.INTER_NEAREST)
        labels = depth_layers(mask, inner(mask.astype(np.uint8)) > 0, z, round(LEAST_AREA * mask.size))
        count = int(labels.max()) + 1
    area = np.bincount(labels.reshape(-1), minlength=count)[1:]
    large = 1 + np.argsort(-area, kind="stable")[: min(255, int((area >= LEAST_AREA * mask.size).sum()))]
    renumbered = np.zeros(count, np.uint8)
    renumbered[large] = np.arange(1, len(large) + 1)
    return renumbered[labels]


def _claims(chain: Chain, objects: Objects, k: int, rng: np.random.Generator) -> list[tuple[int, int, int, float]]:
    """(pixels found again, part in frame ``k``, part in the next frame, logarithm of its growth) for each part that continues."""
    before, now = objects.labels[k], objects.labels[k + 1]
    claims = []
    for part in range(1, int(before.max()) + 1):
        inside = np.argwhere(before == part)
        chosen = rng.permutation(inside)[:PIXELS, ::-1]
        places = ((chosen + 0.5) * objects.step - 0.5).astype(np.float32)
        moved = chain.move(k, 1, places)
        if moved is None:
            return []
        there, trusted = moved
        lands = np.where(trusted, now[objects.at(k + 1, *there.T)], 0)
        counts = np.bincount(lands, minlength=1)
        counts[0] = 0
        target = int(counts.argmax())
        found = lands == target
        if counts[target] >= FEWEST:
            share = len(inside) * int(counts[target]) // len(chosen)
            claims.append((share, part, target, _growth(places[found], there[found], rng)))
    return claims


def _growth(places: np.ndarray, there: np.ndarray, rng: np.random.Generator) -> float:
    """Median logarithm of the factor by which distances between points grow from ``places`` to ``there`` [n, 2]."""
    a, b = rng.integers(len(places), size=(2, PAIRS))
    first, second = (np.linalg.norm(p[a] - p[b], axis=1) for p in (places, there))
    far = first > np.percentile(first, 50)
    return float(np.median(np.log(np.maximum(second[far], 1e-3) / first[far]))) if far.any() else 0.0


def inner(labels: np.ndarray) -> np.ndarray:
    """``labels`` [H, W] without the rim of each part."""
    inset = max(1, round(INSET * labels.shape[1]))
    return np.where(cv2.erode((labels > 0).astype(np.uint8), np.ones((2 * inset + 1, 2 * inset + 1), np.uint8)) > 0, labels, 0)
