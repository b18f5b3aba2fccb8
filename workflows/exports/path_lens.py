"""How wide the views of a path file look, and how large their pictures are."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ...pipeline import CaptureError
from ...stages.captures import checks

LARGEST = 1e7  # px
LONGEST = 16_384  # px of a side of a picture
SAME = 0.01  # by which two statements about one lens may differ, as a share of the focal length
SIZES = (("w", "h"), ("render_width", "render_height"))
FOCAL = ("K", "fl_x", "fl_y", "camera_angle_x", "camera_angle_y", "fov")
BENT = ("k1", "k2", "k3", "k4", "k5", "k6", "p1", "p2")  # distortion, which is not rendered
KINDS = ("camera_type", "camera_model")
FLAT = ("perspective", "pinhole", "simple_pinhole", "simple_radial", "radial", "opencv", "full_opencv")
FIELDS = (*(name for pair in SIZES for name in pair), *FOCAL, "cx", "cy", "aspect", *BENT, *KINDS, "is_fisheye")


def refuse_other_kinds(fields: Mapping[str, Any], where: str) -> None:
    """Raises CaptureError if ``fields`` ask for pictures that are not perspective."""
    for name in KINDS:
        kind = fields.get(name)
        if kind is not None and str(kind).lower() not in FLAT:
            raise CaptureError(f"{where}: {name} {kind!r:.40}: only perspective pictures are rendered; make the path with such a camera")
    if fields.get("is_fisheye"):
        raise CaptureError(f"{where}: is_fisheye: only perspective pictures are rendered; make the path with such a camera")


def size_of(data: Mapping[str, Any], rows: Sequence[Mapping[str, Any]], usual: tuple[int, int], where: str) -> tuple[tuple[int, int], bool]:
    """((width, height) px of the pictures of a path file, whether the file states it); ``usual`` where it does not. A file that states only
    an aspect gets the longer side of ``usual``. Raises CaptureError if the file contradicts itself."""
    found: dict[tuple[int, int], str] = {}
    for fields, place in ((data, where), *((row, f"{where}: frame {i}") for i, row in enumerate(rows))):
        for across, down in SIZES:
            if (across in fields) != (down in fields):
                given, missing = (across, down) if across in fields else (down, across)
                raise CaptureError(f"{place}: it has {given} without {missing}; add it")
            if across in fields:
                pair = (fields[across], across), (fields[down], down)
                width, height = (checks.integer(value, f"{place}: {name}", 1, LONGEST) for value, name in pair)
                found.setdefault((width, height), place)
    if len(found) > 1:
        (a, first), (b, second) = list(found.items())[:2]
        raise CaptureError(
            f"{second}: pictures of {b[0]}x{b[1]}, but {first} says {a[0]}x{a[1]}; all pictures of a path have one size, correct the file"
        )
    if found:
        return next(iter(found)), True
    aspects = {
        checks.number(fields["aspect"], f"{place}: aspect", 1e-3, 1e3)
        for fields, place in ((data, where), *((row, f"{where}: frame {i}") for i, row in enumerate(rows)))
        if "aspect" in fields
    }
    if len(aspects) > 1:
        raise CaptureError(f"{where}: several values of aspect; all pictures of a path have one size, add render_width and render_height")
    if not aspects:
        return usual, False
    aspect, longer = aspects.pop(), max(usual)
    return (longer, max(1, round(longer / aspect))) if aspect >= 1 else (max(1, round(longer * aspect)), longer), False


def lens_of(data: Mapping[str, Any], row: Mapping[str, Any], size: tuple[int, int], where: str) -> np.ndarray | None:
    """K [3, 3] px of the view ``row`` of a path file with the fields ``data`` at its top, for pictures of ``size`` (width, height); None if
    neither says how wide it looks. What a view says itself comes first.

    Read are K, fl_x and fl_y (px), camera_angle_x and camera_angle_y (radians) and fov (degrees from top to bottom), and cx and cy (px; the
    middle by default). Raises CaptureError if two of them disagree.
    """
    fields = next((fields for fields in (row, data) if any(name in fields for name in FOCAL)), None)
    if fields is None:
        lone = next((name for name in ("cx", "cy") if name in row or name in data), None)
        if lone is not None:
            raise CaptureError(f"{where}: it has {lone} but nothing that says how wide it looks; add fl_x or K")
        return None
    lenses = _stated(fields, size, where)
    (name, K), *others = lenses
    for other, lens in others:
        if np.abs(np.diag(lens)[:2] / np.diag(K)[:2] - 1).max() > SAME:
            told = f"{name} is {K[0, 0]:.6g} px, {other} {lens[0, 0]:.6g} px in pictures of {size[0]}x{size[1]}"
            raise CaptureError(f"{where}: {name} and {other} disagree about the lens ({told}); remove one of them")
    if name != "K":
        for axis, key in enumerate(("cx", "cy")):
            value = row.get(key, data.get(key))
            if value is not None:
                K[axis, 2] = checks.number(value, f"{where}: {key}", -LARGEST, LARGEST)
    return K


def _stated(fields: Mapping[str, Any], size: tuple[int, int], where: str) -> list[tuple[str, np.ndarray]]:
    """Each statement of ``fields`` about the focal length, the most exact first: its name, and K with the middle of the picture."""
    width, height = size
    found = []

    def add(name: str, fx: float, fy: float) -> None:
        found.append((name, checks.intrinsics(fx, fy, width / 2, height / 2, where)))

    def angle(name: str, side: int, most: float) -> float:
        value = checks.number(fields[name], f"{where}: {name}", 1e-4, most)
        return 0.5 * side / float(np.tan(0.5 * value))

    if "K" in fields:
        K = checks.matrix(fields["K"], f"{where}: K", ((3, 3),))
        for name, entry in (("fx", K[0, 0]), ("fy", K[1, 1]), ("cx", K[0, 2]), ("cy", K[1, 2])):
            checks.number(float(entry), f"{where}: K: {name}", -LARGEST, LARGEST)
        found.append(("K", checks.intrinsics(K[0, 0], K[1, 1], K[0, 2], K[1, 2], f"{where}: K", skew=K[0, 1])))
    lengths = [checks.number(fields[name], f"{where}: {name}", 1e-6, LARGEST) for name in ("fl_x", "fl_y") if name in fields]
    if lengths:
        add("fl_x" if "fl_x" in fields else "fl_y", lengths[0], lengths[-1])
    sides = ("camera_angle_x", width), ("camera_angle_y", height)
    angles = [angle(name, side, 3.14) for name, side in sides if name in fields]
    if angles:
        add("camera_angle_x" if "camera_angle_x" in fields else "camera_angle_y", angles[0], angles[-1])
    if "fov" in fields:
        degrees = checks.number(fields["fov"], f"{where}: fov", 1e-2, 179.9)
        focal = 0.5 * height / float(np.tan(0.5 * np.radians(degrees)))
        add("fov", focal, focal)
    return found
