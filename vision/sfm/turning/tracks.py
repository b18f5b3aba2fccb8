"""`Tracks`: features joined over many images by their pairwise matches. Uses only numpy."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

LONG_ENOUGH = 3  # images; two always agree along the epipolar line
QUOTA = 150  # tracks chosen for each image, before the longest remaining ones fill up the rest


@dataclass(frozen=True)
class Tracks:
    """Observation o says that track `track[o]` is in image `frame[o]` at `xy[o]` px; xy is [O, 2]. Tracks are 0 .. count - 1, sorted."""

    frame: np.ndarray
    track: np.ndarray
    xy: np.ndarray
    count: int


def join(matches: Mapping[tuple[int, int], np.ndarray], places: list[np.ndarray], most: int) -> Tracks:
    """Tracks of at least three images, from matches {(a, b): [M, 2] feature numbers in images a and b} and places [n] of [N, 2] px.

    A track with two features in one image is a mistake and is left out. At most `most` tracks are kept: the longest of each image first,
    then the longest of the rest.
    """
    offsets = np.cumsum([0, *(len(p) for p in places)])
    root = np.arange(offsets[-1])

    def find(i: int) -> int:
        while root[i] != i:
            root[i] = root[root[i]]
            i = int(root[i])
        return i

    for (a, b), pairs in matches.items():
        for i, j in zip(pairs[:, 0] + offsets[a], pairs[:, 1] + offsets[b], strict=True):
            x, y = find(int(i)), find(int(j))
            if x != y:
                root[max(x, y)] = min(x, y)
    labels = np.array([find(i) for i in range(len(root))], np.int64)
    frame = np.repeat(np.arange(len(places)), np.diff(offsets))
    order = np.lexsort((frame, labels))
    labels, frame = labels[order], frame[order]
    xy = np.concatenate([np.zeros((0, 2)), *places])[order]
    _, track, length = np.unique(labels, return_inverse=True, return_counts=True)
    twice = np.zeros(len(length), bool)
    same = (np.diff(track) == 0) & (np.diff(frame) == 0)
    twice[track[1:][same]] = True
    chosen = _choose(np.flatnonzero((length >= LONG_ENOUGH) & ~twice), length, track, frame, len(places), most)
    number = np.full(len(length), -1)
    number[chosen] = np.arange(len(chosen))
    kept = number[track] >= 0
    return Tracks(frame[kept], number[track[kept]], xy[kept], len(chosen))


def _choose(good: np.ndarray, length: np.ndarray, track: np.ndarray, frame: np.ndarray, images: int, most: int) -> np.ndarray:
    if len(good) <= most:
        return good
    quota = min(QUOTA, max(1, most // max(1, images // 8)))
    wanted = np.zeros(len(length), bool)
    allowed = np.zeros(len(length), bool)
    allowed[good] = True
    for i in range(images):
        mine = track[frame == i]
        mine = mine[allowed[mine]]
        wanted[mine[np.argsort(-length[mine], kind="stable")][:quota]] = True
    first = np.flatnonzero(wanted)
    if len(first) < most:
        rest = good[~wanted[good]]
        first = np.concatenate([first, rest[np.argsort(-length[rest], kind="stable")][: most - len(first)]])
    return np.sort(first[np.argsort(-length[first], kind="stable")][:most])
