"""Exposure brackets: photos of one view that a camera takes one after another with less and more light."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

from ...pipeline import counted
from .exposure import Exposure, exposure

_SIZES = (9, 7, 5, 3)  # photos that cameras take of one view
_LONGEST = 2.0  # s from one to the next; clocks of EXIF have whole seconds, and a long exposure takes its time
_LEAST_STEP, _UNEVEN = 0.3, 0.2  # stops from one exposure to the next, and by how much two steps differ: cameras round their times
_SHARE = 0.5  # of the photos that brackets must be: a few that change evenly are chance


def brackets(root: Path, names: Sequence[str]) -> list[list[str]]:
    """Groups of `names`, photos relative to `root` in the order in which they were taken, that are one view with several exposures; each
    from the least light to the most. Empty if few or none of the photos are.

    Photos of a group follow one another within seconds, and their exposures, as EXIF data tell them, are evenly apart. Without these data
    nothing is found."""
    if not names or exposure(root / names[0]) is None:  # the others are of the same camera
        return []
    told = [exposure(root / name) for name in names]
    # A camera takes all its brackets alike. Of nine photos from dark to light, three and three would fit as well, so more come first.
    found = max((_groups(told, size) for size in _SIZES), key=lambda groups: sum(map(len, groups)))
    if sum(map(len, found)) < max(_SHARE * len(names), 1):
        return []
    return [[names[k] for k in group] for group in found]


def middle_exposures(root: Path, names: Sequence[str]) -> tuple[list[str], list[str], tuple[str, ...]]:
    """(`names` with only the middle exposure of each of their `brackets`, those that are left out, a note for people about them)."""
    groups = brackets(root, names)
    if not groups:
        return list(names), [], ()
    out = {name for group in groups for k, name in enumerate(group) if k != len(group) // 2}
    first = sorted(groups[0], key=names.index)
    note = (
        f"{counted(len(groups), 'view')} with {len(groups[0])} exposures each (brackets, by EXIF data; the first is {first[0]} to "
        f"{first[-1]}): the middle exposure is used, and {len(out)} photos are left out; to use others, put them alone into a folder"
    )
    return [name for name in names if name not in out], [name for name in names if name in out], (note,)


def _groups(told: Sequence[Exposure | None], size: int) -> list[list[int]]:
    """The brackets of ``size`` photos, one after another: their places, each from the least light to the most."""
    found, i = [], 0
    while i + size <= len(told):
        shots = [one for one in told[i : i + size] if one is not None]
        if len(shots) == size and _is_bracket(shots):
            found.append([i + k for _, k in sorted((one.stops, k) for k, one in enumerate(shots))])
            i += size
        else:
            i += 1
    return found


def _is_bracket(shots: Sequence[Exposure]) -> bool:
    stops = sorted(one.stops for one in shots)
    steps = [b - a for a, b in pairwise(stops)]
    quick = all(0 <= b.second - a.second <= _LONGEST for a, b in pairwise(shots))
    return quick and min(steps) >= _LEAST_STEP and max(steps) - min(steps) <= _UNEVEN * max(1.0, min(steps))
