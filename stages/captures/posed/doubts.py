"""Checks of intrinsics that hold for every layout: what no camera has is an error, and what few have is told."""

from __future__ import annotations

import math
from collections.abc import Sequence

from ....pipeline import CaptureError
from ..reading import Shot

WIDEST = 150.0  # degrees of view of a lens without fisheye terms; wide action cameras have 120
_SQUARE = 1.2  # largest ratio of fx and fy that needs no word


def doubts(shots: Sequence[Shot], files: Sequence[str] = ()) -> tuple[str, ...]:
    """Notes for people about principal points outside the middle half of their pictures, and about pixels that are far from square.
    files: what was read, the likeliest source of intrinsics first. Raises CaptureError for a field of view that only fisheye lenses have.
    """
    off, oblong, seen = [], [], set()
    given = f" ({files[0]}{', ...' if len(files) > 1 else ''})" if files else ""
    for shot in shots:
        if shot.K is None:
            continue
        width, height = shot.size
        key = (id(shot.K), shot.size)
        if key in seen:
            continue
        seen.add(key)
        fx, fy, cx, cy = (float(shot.K[place]) for place in ((0, 0), (1, 1), (0, 2), (1, 2)))
        for focal, extent, name in ((fx, width, "wide"), (fy, height, "high")):
            view = 2 * math.degrees(math.atan(0.5 * extent / focal))
            if view > WIDEST and not shot.fisheye:
                raise CaptureError(
                    f"{shot.name}: a focal length of {focal:.4g} px for a picture that is {extent} px {name} means a field of view of "
                    f"{view:.0f} degrees, which only fisheye lenses have; correct the focal length{given}"
                )
        if abs(cx - width / 2) > width / 4 or abs(cy - height / 2) > height / 4:
            off.append((shot.name, cx, cy, width, height))
        if max(fx / fy, fy / fx) > _SQUARE:
            oblong.append((shot.name, fx, fy))
    notes = []
    if off:
        name, cx, cy, width, height = off[0]
        notes.append(
            f"warning: the principal point of {len(off)} picture(s) lies outside the middle half (first {name}: {cx:.1f}, {cy:.1f} in "
            f"{width}x{height}); if the intrinsics were made for pictures of another size, give that size (w and h) with them"
        )
    if oblong:
        name, fx, fy = oblong[0]
        notes.append(
            f"warning: the focal lengths of {len(oblong)} picture(s) in x and y differ (first {name}: {fx:.1f} and {fy:.1f} px), as if "
            "pixels were not square; correct them if the camera has square pixels"
        )
    return tuple(notes)
