"""Chooses which pictures of several cameras structure from motion uses, and which of them are matched.

A camera that stands still is a single COLMAP image with one pose, however many of its pictures are used: the image gets the features of
all of them. Pictures of two cameras are matched only at equal times, so moving objects help to connect cameras like everything else.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ...pipeline.choice.evenly import evenly
from ..sequences import camera_sequences
from .pairs import choose, image_pairs

MOST, FEWEST = 6, 2  # number of times used for cameras that stand still
PAIRS = 240  # pairs of cameras, over all times; beyond this, fewer times are used


@dataclass(frozen=True)
class Looks:
    """frames [L]: the frames used. image [L]: the COLMAP image that each belongs to. pairs: indices into `frames` of the pictures that are
    matched. image_of_frame [F]: the image that holds each frame's pose. fixed: cameras that stand still."""

    frames: list[int]
    image: list[int]
    pairs: list[tuple[int, int]]
    image_of_frame: np.ndarray
    fixed: frozenset[int]

    @property
    def all_fixed(self) -> bool:
        return len(set(self.image)) == len(self.fixed)

    def image_pairs(self) -> list[tuple[int, int]]:
        return sorted({(self.image[a], self.image[b]) for a, b in self.pairs})


def look_times(cameras: int, times: int) -> int:
    """How many of the times are used for cameras that stand still."""
    pairs = max(1, cameras * (cameras - 1) // 2)
    return min(times, max(FEWEST, min(MOST, PAIRS // pairs)))


def choose_looks(camera: np.ndarray, time: np.ndarray, fixed: Mapping[int, bool], matcher: str | None, overlap: int) -> Looks:
    """camera, time [F] as in the `frames` artifact; fixed: whether each camera stands still; matcher, overlap: settings of `poses`, which
    apply to the frames of a camera that moves."""
    sequences = camera_sequences(camera, time)
    shared = sorted(set.intersection(*({float(time[i]) for i in mine} for mine in sequences.values())))
    count = look_times(len(sequences), len(shared))
    seen = set(evenly(shared, count))
    frames: list[int] = []
    image: list[int] = []
    pairs: set[tuple[int, int]] = set()
    image_of_frame = np.zeros(len(camera), np.int64)
    at: dict[float, list[int]] = {}  # indices into `frames` at each time, by camera
    images = 0
    for number, mine in sequences.items():
        chosen = [i for i in mine if float(time[i]) in seen] or [mine[0]] if fixed[number] else mine
        first = len(frames)
        for k, i in enumerate(chosen):
            at.setdefault(float(time[i]), []).append(len(frames))
            frames.append(i)
            image.append(images if fixed[number] else images + k)
        if fixed[number]:
            image_of_frame[mine] = images
            images += 1
        else:
            image_of_frame[mine] = np.arange(images, images + len(mine))
            images += len(mine)
            own = image_pairs(choose(matcher, len(mine), False), len(mine), overlap)
            pairs |= {(first + a, first + b) for a, b in own}
    for together in at.values():
        pairs |= {(a, b) for n, a in enumerate(together) for b in together[n + 1 :]}
    return Looks(frames, image, sorted(pairs), image_of_frame, frozenset(c for c, stands in fixed.items() if stands))


def expand(arrays: Mapping[str, np.ndarray], image_of_frame: Sequence[int] | np.ndarray) -> dict[str, np.ndarray]:
    """Expands arrays per image [n, ...] to arrays per frame [F, ...]. Frames of one image get bit-equal poses."""
    of_images = ("registered", "K", "cam_from_world", "distortion", "size")
    return {name: array[np.asarray(image_of_frame)] if name in of_images else array for name, array in arrays.items()}
