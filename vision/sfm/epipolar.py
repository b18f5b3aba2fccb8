"""Matching with known cameras: descriptors are compared only along epipolar lines. Uses only numpy."""

from __future__ import annotations

import numpy as np

MAX_DISTANCE = 0.7  # between unit descriptors
MAX_RATIO = 0.8  # distance of the nearest to that of the second nearest, both on the epipolar line
BLOCK = 128  # rows of the similarity matrix at a time
SAME_PLACE = 2.0  # px; a second candidate this close is the same feature at another scale or orientation


def fundamental(K1: np.ndarray, K2: np.ndarray, cam1_from_world: np.ndarray, cam2_from_world: np.ndarray) -> np.ndarray:
    """The fundamental matrix [3,3]: x2^T F x1 = 0 for homogeneous pixels of one point (Hartley and Zisserman, 9.2)."""
    relative = cam2_from_world @ np.linalg.inv(cam1_from_world)
    x, y, z = relative[:3, 3]
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.linalg.inv(K2).T @ cross @ relative[:3, :3] @ np.linalg.inv(K1)


def guided_matches(
    xy1: np.ndarray, unit1: np.ndarray, xy2: np.ndarray, unit2: np.ndarray, F: np.ndarray, max_error: float = 2.0
) -> np.ndarray:
    """Indices [M,2] uint32 of mutual nearest neighbours whose distance to the epipolar line is at most `max_error` px in both images.

    xy1 [N,2], xy2 [M,2] px; unit1 [N,128], unit2 [M,128] float32 of norm 1.
    """
    rows, columns, cosine = _candidates(xy1, unit1, xy2, unit2, F, max_error)
    # a stable sort by column keeps rows in order, so ties go to the lowest index
    by_column = np.argsort(columns, kind="stable")
    best_of_row, best_of_column = np.zeros(len(rows), bool), np.zeros(len(rows), bool)
    best_of_row[_best(rows, cosine)] = True
    best_of_column[by_column[_best(columns[by_column], cosine[by_column])]] = True
    mutual = best_of_row & best_of_column & (cosine > 0)
    second = np.maximum(
        _second(rows, cosine, best_of_row, xy2[columns]),
        _back(by_column, _second(columns[by_column], cosine[by_column], best_of_column[by_column], xy1[rows[by_column]])),
    )
    distance = _distance(cosine)
    keep = mutual & (distance <= MAX_DISTANCE) & (distance < MAX_RATIO * _distance(second))
    return np.column_stack([rows[keep], columns[keep]]).astype(np.uint32)


def _candidates(
    xy1: np.ndarray, unit1: np.ndarray, xy2: np.ndarray, unit2: np.ndarray, F: np.ndarray, max_error: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pairs of features near each other's epipolar lines: rows (sorted), columns, cosine of their descriptors."""
    one1 = np.column_stack([xy1, np.ones(len(xy1))])
    one2 = np.column_stack([xy2, np.ones(len(xy2))])
    line2, line1 = one1 @ F.T, one2 @ F
    tiny = np.finfo(np.float32).tiny
    scale2 = (max_error * np.hypot(line2[:, 0], line2[:, 1])).astype(np.float32) + tiny
    scale1 = (max_error * np.hypot(line1[:, 0], line1[:, 1])).astype(np.float32) + tiny
    left, right = line2.astype(np.float32), np.ascontiguousarray(one2.T, np.float32)
    found = []
    for start in range(0, len(xy1), BLOCK):  # one block of the matrix fits the cache
        block = slice(start, start + BLOCK)
        residual = np.abs(left[block] @ right)
        flat = np.flatnonzero((residual <= scale2[block, None]) & (residual <= scale1))
        similarity = unit1[block] @ unit2.T
        found.append((flat // max(1, len(xy2)) + start, flat % max(1, len(xy2)), similarity.ravel()[flat]))
    if not found:
        return np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros(0, np.float32)
    rows, columns, cosine = (np.concatenate(part) for part in zip(*found))
    return rows, columns, cosine


def _starts(groups: np.ndarray) -> np.ndarray:
    return np.flatnonzero(np.diff(groups, prepend=-1))


def _best(groups: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Index of the first highest value in each group; `groups` must be sorted."""
    if not len(groups):
        return np.zeros(0, np.int64)
    starts = _starts(groups)
    highest = np.repeat(np.maximum.reduceat(values, starts), np.diff(starts, append=len(groups)))
    at = np.flatnonzero(values == highest)
    return at[_starts(groups[at])]


def _second(groups: np.ndarray, values: np.ndarray, is_best: np.ndarray, place: np.ndarray) -> np.ndarray:
    """For every entry, the highest value in its group at another place than the group's best; -1 if there is none."""
    if not len(groups):
        return np.zeros(0, np.float32)
    starts = _starts(groups)
    sizes = np.diff(starts, append=len(groups))
    best_place = np.repeat(place[is_best], sizes, axis=0)
    away = ((place - best_place) ** 2).sum(axis=1) > SAME_PLACE**2
    return np.repeat(np.maximum.reduceat(np.where(away, values, np.float32(-1)), starts), sizes)


def _back(order: np.ndarray, values: np.ndarray) -> np.ndarray:
    out = np.empty_like(values)
    out[order] = values
    return out


def _distance(cosine: np.ndarray) -> np.ndarray:
    return np.sqrt(np.maximum(0.0, 2.0 - 2.0 * cosine))
