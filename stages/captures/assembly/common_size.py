"""A common size for pictures of different sizes, of the shape that most of them have. The others are scaled to cover it, and the excess is
cropped."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np

Size = tuple[int, int]
Crop = tuple[int, int, int, int]
_ALIKE = 0.02  # relative difference of aspect ratios below which sizes have one shape, up to rounding


def common_size(sizes: Sequence[Size]) -> Size:
    """The most frequent size of the aspect ratio that most pictures have; among equally frequent ones the smallest, so that less is
    enlarged, and of these the widest, but none of less than a quarter of the largest. Of aspect ratios that equally many have, that by
    which the least is cropped."""
    counts = Counter(sizes)
    largest = {n: max(w * h for (w, h), count in counts.items() if count == n) for n in counts.values()}
    tiny = {(w, h): 4 * w * h < largest[n] for (w, h), n in counts.items()}
    distinct = sorted(counts, key=lambda size: (-counts[size], tiny[size], size[0] * size[1], -size[0]))
    weights = np.array([counts[size] for size in distinct], np.float64)
    aspects = np.log([width / height for width, height in distinct])
    having = [float(weights[np.abs(aspects - aspect) < _ALIKE].sum()) for aspect in aspects]
    most = [i for i, n in enumerate(having) if n == max(having)]
    lost = {i: round(float((1 - np.exp(-np.abs(aspects - aspects[i]))) @ weights), 6) for i in most}
    best = aspects[min(most, key=lambda i: (lost[i], i))]
    return next(size for size, aspect in zip(distinct, aspects, strict=True) if abs(aspect - best) < _ALIKE)


def crop(size: Size, common: Size) -> Crop:
    """Left, top, width, height, px, of the largest centred part of a picture of `size` with the aspect ratio of `common`, to a pixel."""
    (width, height), (w, h) = size, common
    scale = min(width / w, height / h)
    across, down = min(width, max(1, round(w * scale))), min(height, max(1, round(h * scale)))
    return (width - across) // 2, (height - down) // 2, across, down


def told(sizes: Sequence[Size], names: Sequence[str], common: Size) -> str | None:
    """A sentence about what happens to pictures of other sizes; None if all have the common size."""
    others = [i for i, size in enumerate(sizes) if size != common]
    if not others:
        return None
    lost = max(1 - c[2] * c[3] / (sizes[i][0] * sizes[i][1]) for i in others for c in [crop(sizes[i], common)])
    larger = max(common[0] / crop(sizes[i], common)[2] for i in others)
    first = others[0]
    return (
        f"{len(others)} of {len(sizes)} pictures are not {common[0]}x{common[1]} px{_why(sizes, common)} (first {names[first]}, "
        f"{sizes[first][0]}x{sizes[first][1]}): they are scaled to that size, "
        + (f"with up to {lost:.0%} of a picture cropped at its sides" if lost >= 0.005 else "whole")
        + (f", and enlarged up to {larger:.2g} times" if larger > 1.005 else "")
    )


def _why(sizes: Sequence[Size], common: Size) -> str:
    """What most pictures have of the common size, if anything."""
    if 2 * sum(size == common for size in sizes) > len(sizes):
        return " as most are"
    shape = common[0] / common[1]
    alike = sum(abs(np.log(width / height / shape)) < _ALIKE for width, height in sizes)
    return ", the shape of most" if 2 * alike > len(sizes) else ""
