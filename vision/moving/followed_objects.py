"""The objects that one camera's masks show over time, and how their apparent size changes.

A rigid object's depth is inversely proportional to its apparent size, so its depth in one frame determines it in all frames.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from ..flow.chain import Chain
from .attached_parts import bodies
from .object_labels import object_labels
from .object_sizes import object_sizes


class Objects(NamedTuple):
    """labels: for each frame [h, w] uint8, 1 + the number of each pixel's object, 0 where nothing moves. They are smaller than the picture:
    `step` is the size of one of their pixels in picture pixels, in x and y. log_size [F, N + 1]: by frame and label, the logarithm of the
    apparent size, up to a constant for each object. body: the larger object to which an object belongs, by label."""

    labels: list[np.ndarray]
    step: tuple[float, float]
    log_size: np.ndarray
    body: Mapping[int, int] = {}

    def at(self, k: int, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Row and column in the labels of frame ``k`` for picture pixels ``x``, ``y``, with pixel centres at whole numbers."""
        height, width = self.labels[k].shape
        row, column = ((np.asarray(v) + 0.5) / s for v, s in ((y, self.step[1]), (x, self.step[0])))
        return np.clip(row.astype(int), 0, height - 1), np.clip(column.astype(int), 0, width - 1)


def follow_objects(chain: Chain, frames: int, seed: int = 0) -> Objects:
    """The objects on the masks of ``chain`` in its first ``frames`` frames."""
    labels = object_labels(chain, frames)
    height, width = labels[0].shape
    return Objects(labels, (chain.width / width, chain.height / height), object_sizes(chain, labels, seed), bodies(chain, labels))
