"""Which objects of one camera's masks are parts of a larger one: they touch it and move as it does where they touch."""

from __future__ import annotations

import cv2
import numpy as np

from ..flow.chain import Chain

REACH = 2  # px of the labels on both sides of where two objects touch
FEWEST = 6  # least number of pixels on either side that tell how it moves
ALIKE = 0.004  # of the picture's width a frame, by which both sides may differ
SHARE = 0.6  # of the frames in which two objects touch, in which they must move alike
FRAMES = 3  # least number of these


def bodies(chain: Chain, labels: list[np.ndarray]) -> dict[int, int]:
    """For each label of ``labels`` (see `object_labels`) that is a part of a larger object, the label of that."""
    touched: dict[tuple[int, int], list[bool]] = {}
    area = sum((np.bincount(one.ravel(), minlength=256) for one in labels), np.zeros(256, int))
    for k, now in enumerate(labels[:-1]):
        present = [int(n) for n in np.unique(now[now > 0])]
        near = {n: cv2.dilate((now == n).astype(np.uint8), np.ones((2 * REACH + 1, 2 * REACH + 1), np.uint8)) > 0 for n in present}
        for a in present:
            for b in present:
                sides = ((now == a) & near[b], (now == b) & near[a])
                if a >= b or min(int(side.sum()) for side in sides) < FEWEST:
                    continue
                steps = [_step(chain, k, side) for side in sides]
                if steps[0] is not None and steps[1] is not None:
                    apart = float(np.linalg.norm(steps[0] - steps[1]))
                    touched.setdefault((a, b), []).append(apart < ALIKE * chain.width)
    found: dict[int, int] = {}
    for (a, b), alike in sorted(touched.items(), key=lambda item: -sum(item[1])):
        small, large = (a, b) if area[a] < area[b] else (b, a)
        if sum(alike) >= max(FRAMES, SHARE * len(alike)) and small not in found:
            found[small] = large
    return {n: _last(found, n) for n in found}


def _last(found: dict[int, int], n: int) -> int:
    """The body of the body ... of ``n``; each is larger than the one before, so there is an end."""
    while n in found:
        n = found[n]
    return n


def _step(chain: Chain, k: int, side: np.ndarray) -> np.ndarray | None:
    """Median displacement [2] px of the pixels ``side`` [h, w] from frame ``k`` to the next; None if too few are known."""
    height, width = side.shape
    y, x = np.nonzero(side)
    places = ((np.stack([x, y], 1) + 0.5) * [chain.width / width, chain.height / height] - 0.5).astype(np.float32)
    moved = chain.move(k, 1, places)
    if moved is None or moved[1].sum() < FEWEST:
        return None
    return np.asarray(np.median((moved[0] - places)[moved[1]], axis=0))
