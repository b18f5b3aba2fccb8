"""Labels of the objects that one camera's masks show, carried from frame to frame pixel by pixel with the flow.

Whole parts of masks cannot tell two people apart whose masks touch, and make a new object of an arm that leaves the body's mask for a
moment. Pixels that keep their labels do both: a part of a mask with pixels of two objects is divided between them, and a part whose pixels
come from one object belongs to it, however many parts that object has.
"""

from __future__ import annotations

from itertools import count

import cv2
import numpy as np
from scipy.ndimage import distance_transform_edt

from ..flow.chain import Chain

FEWEST = 12  # least number of pixels that come from an object, for a part to have it
SHARE = 0.08  # and least share of the part's pixels whose flow is trusted
LEAST_AREA = 1e-3  # of the picture; smaller parts are noise of the mask
APART = 12  # frames; what has been a part of its own for so long is an object of its own
MOST = 255  # objects


def object_labels(chain: Chain, frames: int) -> list[np.ndarray]:
    """For each of the first ``frames`` frames of ``chain`` [h, w] uint8 at the size of its small masks: 1 + the object's number, 0 where
    nothing moves. Objects are numbered in the order in which they appear; those after the first `MOST` share the last number."""
    fresh = count(1)
    labels: list[np.ndarray] = []
    apart: dict[int, tuple[int, int]] = {}  # of the last frame's part: (object, frames for which it has been apart from it)
    before = np.zeros((0, 0), np.int32)
    for k in range(frames):
        part_of = parts(chain.small_mask(k)).astype(np.int32)
        found = np.zeros(part_of.shape, np.int32)
        source = _sources(chain, k, part_of) if k else None
        largest: dict[int, tuple[int, int]] = {}
        for part in range(1, int(part_of.max()) + 1):
            inside = part_of == part
            came = _came(labels[-1], source, inside) if source is not None else np.zeros(part_of.shape, np.int32)
            owners = _owners(came, inside)
            if not len(owners):
                found[inside] = next(fresh)
                continue
            found[inside] = owners[0] if len(owners) == 1 else _divided(came, inside, owners)
            if len(owners) == 1:
                largest[owners[0]] = max(largest.get(owners[0], (0, 0)), (int(inside.sum()), part))
        now: dict[int, tuple[int, int]] = {}
        for part in range(1, int(part_of.max()) + 1):
            inside = part_of == part
            owner = np.unique(found[inside])
            if len(owner) != 1 or largest.get(int(owner[0]), (0, part))[1] == part or source is None:
                continue
            parent = int(owner[0])
            last = _came(before, source, inside)
            last = last[last > 0]
            known, so_far = apart.get(int(np.bincount(last).argmax()), (parent, 0)) if len(last) else (parent, 0)
            if known == parent and so_far + 1 >= APART:
                found[inside] = next(fresh)
            else:
                now[part] = (parent, so_far + 1 if known == parent else 1)
        apart, before = now, part_of
        labels.append(found)
    return [np.minimum(one, MOST).astype(np.uint8) for one in labels]


def _sources(chain: Chain, k: int, part_of: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """Row and column in frame ``k - 1`` of the pixels of the parts of frame ``k``, [h, w], -1 where the flow is not trusted; None if it was
    not measured."""
    height, width = part_of.shape
    y, x = np.nonzero(part_of)
    step = np.array([chain.width / width, chain.height / height])
    moved = chain.move(k, -1, ((np.stack([x, y], 1) + 0.5) * step - 0.5).astype(np.float32))
    if moved is None:
        return None
    places, trusted = moved
    row, column = (np.full(part_of.shape, -1) for _ in range(2))
    at = np.floor((places + 0.5) / step).astype(int)
    row[y[trusted], x[trusted]] = np.clip(at[trusted, 1], 0, height - 1)
    column[y[trusted], x[trusted]] = np.clip(at[trusted, 0], 0, width - 1)
    return row, column


def _came(labels: np.ndarray, source: tuple[np.ndarray, np.ndarray], inside: np.ndarray) -> np.ndarray:
    """[h, w]: the value in ``labels`` of the last frame from where each pixel ``inside`` comes, 0 where that is not known."""
    known = inside & (source[0] >= 0)
    came = np.zeros(inside.shape, np.int32)
    came[known] = labels[source[0][known], source[1][known]]
    return came


def _owners(came: np.ndarray, inside: np.ndarray) -> list[int]:
    """The objects from which enough of the pixels ``inside`` come, most first."""
    counts = np.bincount(came[inside])
    counts[:1] = 0
    enough = np.flatnonzero(counts >= max(FEWEST, SHARE * counts.sum()))
    return [int(n) for n in enough[np.argsort(-counts[enough], kind="stable")]]


def _divided(came: np.ndarray, inside: np.ndarray, owners: list[int]) -> np.ndarray:
    """The owner [n] of each pixel ``inside``: that of the nearest pixel that comes from one."""
    known = inside & np.isin(came, owners)
    nearest = distance_transform_edt(~known, return_distances=False, return_indices=True)
    divided = came[tuple(nearest)]
    smooth = cv2.medianBlur(np.where(inside, divided, 0).astype(np.uint8), 5) if max(owners) <= MOST else divided
    return np.where(np.isin(smooth, owners), smooth, divided)[inside]


def parts(mask: np.ndarray) -> np.ndarray:
    """[h, w] uint8: labels 1, 2, ... of the connected parts of ``mask`` [h, w] bool, without noise and at most 255 parts; 0 elsewhere."""
    count, labels, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8), connectivity=8)
    area = stats[1:, cv2.CC_STAT_AREA]
    large = 1 + np.argsort(-area, kind="stable")[: min(255, int((area >= LEAST_AREA * mask.size).sum()))]
    renumbered = np.zeros(count, np.uint8)
    renumbered[large] = np.arange(1, len(large) + 1)
    return renumbered[labels]
