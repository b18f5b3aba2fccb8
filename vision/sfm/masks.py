"""Which features lie on moving pixels, and the matches that do not."""

from __future__ import annotations

import numpy as np


def on_moving(masks: np.ndarray, frame: np.ndarray, xy: np.ndarray, size: np.ndarray) -> np.ndarray:
    """[N] bool: whether the mask of frame `frame` [N] covers the position xy [N, 2] px, in pictures of `size` [F, 2] (width, height) px.

    masks [F, h, w] bool, of any size; pixel centres at +0.5 in both. Positions outside the picture count as its border.
    """
    height, width = masks.shape[1:]
    scale = np.array([width, height]) / np.maximum(size[frame], 1)
    x, y = np.floor(np.nan_to_num(xy) * scale).astype(np.int64).T
    return np.asarray(masks[frame, np.clip(y, 0, height - 1), np.clip(x, 0, width - 1)], bool)


def static_matches(matches: np.ndarray, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """The matches [M,2] (feature indices) of which neither end is on moving pixels; first, second [N] bool: which features are."""
    return matches[~(first[matches[:, 0]] | second[matches[:, 1]])]
