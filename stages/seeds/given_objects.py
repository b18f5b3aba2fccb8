"""What depth that came with the capture says about moving objects, and about the static scene."""

from __future__ import annotations

from collections.abc import Mapping

import cv2
import numpy as np

from ...vision.depth.over_time import steadied
from ...vision.moving.followed_parts import Objects, inner
from ..depth.artifact import StoredDepth

FEWEST = 12  # least number of pixels of an object whose depth is known
SURE = 0.5  # least confidence of these
AROUND = 4  # frames on either side over which an object's depth is averaged, with its size, if single pixels are not to be believed
WITHIN = 0.4  # logarithm of the factor between a pixel's depth and that of its object; farther ones show something else
NEARER = 40.0  # percentile of a part's depths that stands for it, if single pixels are not to be believed: they blend into what is behind
SMOOTH = 0.05  # of the picture's width: windows over which the shape of an object is averaged, if single pixels are not to be believed
THICK = 0.15  # logarithm of the factor between an object's depth and that of its parts; what is farther shows something else
LEAST = 0.05  # share of a window that must show the object
WIDTH = 320  # px, longest side of maps of the static scene


def given_numbers(objects: Objects, frames: list[int], given: StoredDepth, depths: list[np.ndarray]) -> list[np.ndarray]:
    """``depths`` of the parts in ``frames``, [labels] each, replaced by the median of the given depth over a part's pixels without its rim.
    If the depth is not precise, the percentile `NEARER` takes the place of the median, and the median over neighbouring frames is taken, in
    which the object's size tells how its depth changed."""
    middle = 50.0 if given.precise else NEARER
    scale: dict[int, dict[int, float]] = {}  # object -> frame -> log(depth * size)
    for k, i in enumerate(frames):
        if i not in given.z:
            continue
        labels = objects.labels[k]
        inside = inner(labels)  # masks extend onto what is behind
        z, sure = (_sized(one[i], labels.shape) for one in (given.z, given.confidence))
        for part in range(1, len(objects.number[k])):
            sound = (z > 0) & (sure >= SURE)
            there = (inside == part) & sound
            if there.sum() < FEWEST:
                there = (labels == part) & sound
            if there.sum() >= FEWEST:
                depth = float(np.percentile(z[there], middle))
                scale.setdefault(int(objects.number[k][part]), {})[k] = float(np.log(depth) + objects.log_size[k][part])
    result = [of.copy() for of in depths]
    around = 0 if given.precise else AROUND
    if not given.precise:
        scale = {number: dict(zip(known, steadied([*known], [*known.values()]).tolist(), strict=True)) for number, known in scale.items()}
    for k, of in enumerate(result):
        for part in range(1, len(of)):
            known = scale.get(int(objects.number[k][part]), {})
            near = [value for frame, value in known.items() if abs(frame - k) <= around]
            if near:
                of[part] = np.exp(np.median(near) - objects.log_size[k][part])
    return result


def given_surface(given: StoredDepth, i: int, labels: np.ndarray, number: np.ndarray) -> np.ndarray:
    """[h, w] depth of what moves in frame ``i``, whose part ``labels`` [h, w] have the depths ``number`` [h, w]: the given one where single
    pixels are to be believed and do not show something else, else the part's depth with the shape that windows of `SMOOTH` show."""
    z = _sized(given.z[i], number.shape)
    off = np.where(z > 0, np.log(np.maximum(z, 1e-9) / np.maximum(number, 1e-9)), np.inf).astype(np.float32)
    if given.precise:
        return np.where(np.abs(off) < WITHIN, z, number)
    inside, side = inner(labels), 2 * round(0.5 * SMOOTH * labels.shape[1]) + 1
    shape = np.zeros(number.shape, np.float32)
    for part in range(1, int(labels.max()) + 1):
        there = (labels == part) & np.isfinite(off)
        middle = there & (inside == part)
        if middle.sum() < FEWEST:
            continue
        own = off - np.float32(np.percentile(off[middle], NEARER))
        sound = there & (np.abs(own) < THICK)
        share, mean = (cv2.blur(np.where(sound, of, 0).astype(np.float32), (side, side)) for of in (1.0, own))
        shape = np.where(there & (share > LEAST), mean / np.maximum(share, 1e-6), shape)
    return np.asarray(number * np.exp(shape))


def static_inverse(given: StoredDepth, measured: Mapping[int, np.ndarray]) -> dict[int, np.ndarray]:
    """Inverse depth by frame, see `Swept`: as ``measured``, and where that is unknown the given one if single pixels are to be believed."""
    result = dict(measured)
    shape = next((one.shape for one in measured.values()), None)
    for i, z in given.z.items() if given.precise else ():
        known = measured.get(i)
        if shape is None:  # all maps have one size
            step = max(1, round(max(z.shape) / WIDTH))
            shape = z.shape[0] // step, z.shape[1] // step
        there = _sized(np.where(given.confidence[i] >= SURE, z, 0), shape)
        inverse = np.where(there > 0, 1 / np.maximum(there, 1e-9), 0).astype(np.float32)
        result[i] = inverse if known is None else np.where(known > 0, known, inverse)
    return result


def _sized(values: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    return cv2.resize(values, (shape[1], shape[0]), interpolation=cv2.INTER_NEAREST)
