"""Finds what was drawn over the pictures of a moving camera: logos and text, which stand still in the image while the scene moves past."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import NamedTuple

import cv2
import numpy as np

from ...pipeline.choice.evenly import evenly
from .pictures import shrunk

PICTURES, LEAST_PICTURES = 24, 12  # how many pictures are looked at, and how many it takes to judge
LONGEST = 960  # px, longest side of the pictures that are looked at
BLUR = 0.8  # px, against the noise of compression
EDGE = 4.0  # levels per px, least gradient of an edge
STEADY = 0.8  # an edge is steady if in this share of the pictures its gradient is off the median by less than half of that
FAINT_EDGE, FAINT = 2.0, 0.5  # the same of fainter edges, which count beside steady ones
STILL = 0.1  # with a larger share of steady edges the camera hardly moves, so the scene stands still as well
LEAST_EDGES = 80  # px of steady edges in a watermark
TWO_WAYS = 0.1  # least ratio of its gradients' energy across their main direction to that along it; those of a horizon are all parallel
BORDER = 0.3  # of the height or width, within which it lies: what a camera circles stands still in the middle
LARGEST = 0.1  # of the image
APART = 1 / 60  # of the longest side: edges that are closer together belong to one watermark
MARGIN = 2  # px around the edges, which compression blurs
BATCH = 50_000  # pixels that are judged at once, so that memory stays small


def sampled(count: int) -> list[int]:
    """Which of ``count`` pictures, in their order, `find_watermark` should see: evenly spaced ones, or none if there are too few."""
    return evenly(range(count), PICTURES) if count >= LEAST_PICTURES else []


def find_watermark(pictures: Iterable[np.ndarray]) -> np.ndarray | None:
    """[H, W] bool, the boxes of the watermarks in ``pictures``, uint8 [H, W, 3] RGB of one camera, one of which is needed at a
    time. None if there are none, or if it cannot be told: the pictures are too few, or the camera hardly moves.

    A watermark is a small group of edges near the border, in more than one direction, whose gradients are the same in nearly all pictures.
    """
    gradients, height, width = [], 0, 0
    for picture in pictures:
        height, width = picture.shape[:2]
        gradients.append(_gradient(picture))
    if len(gradients) < LEAST_PICTURES:
        return None
    edges = _find_edges(np.stack(gradients))
    if edges.share > STILL:
        return None
    found = np.zeros(edges.steady.shape, np.uint8)
    for rows, columns in _boxes(edges):
        found[rows, columns] = 1
    if not 0 < found.mean() <= LARGEST:
        return None
    return np.asarray(cv2.resize(found, (width, height), interpolation=cv2.INTER_NEAREST) > 0)


def _gradient(picture: np.ndarray) -> np.ndarray:
    """Gradient of the picture's grey levels, int8 [h, w, 2], levels per px, after scaling it down to at most `LONGEST`."""
    grey = cv2.cvtColor(shrunk(picture, LONGEST), cv2.COLOR_RGB2GRAY).astype(np.float32)
    smooth = cv2.GaussianBlur(grey, (0, 0), BLUR)
    both = [cv2.Sobel(smooth, cv2.CV_32F, *axis) / 8 for axis in ((1, 0), (0, 1))]  # the kernel's weights sum to 8 on either side
    return np.stack([np.rint(one.clip(-127, 127)) for one in both], -1).astype(np.int8)


class _Edges(NamedTuple):
    """gradient float32 [h, w, 2], the median over the pictures. steady, faint bool [h, w]: edges that stand still; the steady ones are also
    faint. share: number of steady pixels over that of edge pixels in one picture."""

    gradient: np.ndarray
    steady: np.ndarray
    faint: np.ndarray
    share: float


def _find_edges(gradients: np.ndarray) -> _Edges:
    """The edges that stand still, of ``gradients`` int8 [P, h, w, 2]."""
    shape = gradients.shape[1:]
    median, mean, count = np.zeros(shape, np.float32), np.zeros(shape, np.float32), 0
    steady, faint = np.zeros(shape[:2], bool), np.zeros(shape[:2], bool)
    for one in gradients:
        mean += one / np.float32(len(gradients))
        count += int(np.count_nonzero(np.square(one, dtype=np.float32).sum(-1) >= EDGE**2))
    rows, columns = np.nonzero(np.linalg.norm(mean, axis=-1) >= 0.5 * FAINT_EDGE)  # the others are not steady, and a mean is quick
    for start in range(0, len(rows), BATCH):
        at = rows[start : start + BATCH], columns[start : start + BATCH]
        seen = gradients[:, *at].astype(np.float32)
        median[at] = np.median(seen, 0)
        strength = np.linalg.norm(median[at], axis=-1)
        often, always = np.quantile(np.linalg.norm(seen - median[at], axis=-1), (FAINT, STEADY), axis=0) <= 0.5 * strength
        faint[at] = often & (strength >= FAINT_EDGE)
        steady[at] = always & (strength >= EDGE)
    return _Edges(median, steady, faint, np.count_nonzero(steady) * len(gradients) / max(count, 1))


def _boxes(edges: _Edges) -> Iterator[tuple[slice, slice]]:
    """Rows and columns of the groups of edges that look like watermarks."""
    reach = 2 * round(0.5 * APART * max(edges.faint.shape)) + 1
    joined = cv2.morphologyEx(np.pad(edges.faint, reach).astype(np.uint8), cv2.MORPH_CLOSE, np.ones((reach, reach), np.uint8))
    count, label, stats, _ = cv2.connectedComponentsWithStats(np.ascontiguousarray(joined[reach:-reach, reach:-reach]))
    for group in range(1, count):
        left, top, across, down, _ = (int(v) for v in stats[group])
        box = slice(max(top - MARGIN, 0), top + down + MARGIN), slice(max(left - MARGIN, 0), left + across + MARGIN)
        near = [part.stop <= BORDER * side or part.start >= (1 - BORDER) * side for part, side in zip(box, label.shape, strict=True)]
        mine = edges.gradient[(label == group) & edges.steady]
        low, high = np.linalg.eigvalsh(mine.T @ mine)
        if any(near) and len(mine) >= LEAST_EDGES and low >= TWO_WAYS * high:
            yield box
