"""A common size for pictures of different sizes: the most frequent one. The others are scaled to cover it, and the excess is cropped."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

Size = tuple[int, int]
Crop = tuple[int, int, int, int]


def common_size(sizes: Sequence[Size]) -> Size:
    """The most frequent width and height; among equally frequent ones the smallest, so that less is enlarged."""
    counts = Counter(sizes)
    return min(counts, key=lambda size: (-counts[size], size[0] * size[1], size))


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
        f"{len(others)} of {len(sizes)} pictures are not {common[0]}x{common[1]} px as most are (first {names[first]}, "
        f"{sizes[first][0]}x{sizes[first][1]}): they are scaled to that size, "
        + (f"with up to {lost:.0%} of a picture cropped at its sides" if lost >= 0.005 else "whole")
        + (f", and enlarged up to {larger:.2g} times" if larger > 1.005 else "")
    )
