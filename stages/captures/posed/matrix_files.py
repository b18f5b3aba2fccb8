"""Numbers in small text files: poses, and camera matrices under the names that they have beside colour and depth pictures."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ....pipeline import CaptureError
from .. import checks

_LONGEST = 2**24  # characters: some hundred thousand lines of a trajectory
# K.txt is ours; the others are of 3DMatch, ETH3D, ScanNet and BundleFusion.
INTRINSICS = (
    "K.txt",
    "camera-intrinsics.txt",
    "calibration.txt",
    "intrinsics.txt",
    "intrinsic/intrinsic_color.txt",
    "intrinsic_color.txt",
    "info.txt",
    "_info.txt",
)
_NSVF = re.compile(r"(\S+[ \t]+){3}0[.0]*[ \t]*\r?\n")  # f cx cy 0 on a line of its own, then its grid, height, width


def text_of(root: Path, name: str) -> str:
    """The text of a small file. Raises CaptureError for one that is too long, or no text."""
    path = checks.resolve_inside(root, name, name)
    try:
        with path.open(encoding="utf-8-sig") as file:
            text = file.read(_LONGEST + 1)
    except (OSError, ValueError) as error:
        raise CaptureError(f"{name}: cannot be read as text ({error}); copy it again") from error
    if len(text) > _LONGEST:
        raise CaptureError(f"{name}: longer than {_LONGEST} characters, so it is no file of poses; check the capture")
    return text


def numbers_of(text: str, where: str, counts: Sequence[int]) -> np.ndarray:
    """The numbers in ``text`` as float64; they may be NaN or Inf. Raises CaptureError unless there are one of ``counts`` of them."""
    words = re.split(r"[\s,]+", text.strip()) if len(text) < 10_000 else []
    try:
        values = np.array([float(word) for word in words if word], dtype=np.float64)
    except ValueError as error:
        raise CaptureError(f"{where}: expected {' or '.join(map(str, counts))} numbers ({error}); correct the file") from error
    if len(values) not in counts:
        raise CaptureError(f"{where}: expected {' or '.join(map(str, counts))} numbers, found {len(values)}; correct the file")
    return values


def pose_of(root: Path, name: str) -> np.ndarray | None:
    """[4,4] `world_from_cam` of a file of a 4x4 or 3x4 matrix; None if an entry is not finite, as trackers write where they are lost."""
    values = numbers_of(text_of(root, name), name, (12, 16))
    matrix = np.vstack([values.reshape(-1, 4)[:3], [[0, 0, 0, 1]]]) if len(values) == 12 else values.reshape(4, 4)
    return checks.rigid(matrix, name) if np.isfinite(matrix).all() else None


def is_nsvf(root: Path) -> bool:
    """Whether the capture has intrinsics as NSVF writes them, or its bounding box."""
    file = root / "intrinsics.txt"
    return (root / "bbox.txt").is_file() or (file.is_file() and _NSVF.match(f"{text_of(root, file.name)}\n") is not None)


def intrinsics_of(root: Path) -> tuple[str, np.ndarray, tuple[int, int] | None] | None:
    """(file, K [3,3], size that it is for if the file says so) of the first of `INTRINSICS` that exists; None without one."""
    for name in INTRINSICS:
        if not (root / name).is_file():
            continue
        text, size = text_of(root, name), None
        if name.endswith("info.txt"):
            fields = dict(re.findall(r"^\s*(\w+)\s*=\s*(.*?)\s*$", text, re.MULTILINE))
            text = fields.get("m_calibrationColorIntrinsic", "")
            sides = [fields.get(f"m_color{side}", "") for side in ("Width", "Height")]
            if all(side.isdecimal() and 0 < len(side) < 6 and int(side) for side in sides):
                size = int(sides[0]), int(sides[1])
        nsvf = _NSVF.match(f"{text}\n")
        values = numbers_of(text, name, (4, 9, 11, 12, 16) if nsvf else (4, 9, 12, 16))
        if nsvf and len(values) < 12:
            fx, fy, cx, cy, skew = values[0], *values[:3], 0.0
            size = (int(values[10]), int(values[9])) if len(values) == 11 and 1 <= values[9:].min() <= values[9:].max() < 1e6 else None
        elif len(values) == 4:
            fx, fy, cx, cy, skew = *values, 0.0
        else:
            matrix = values.reshape(3, -1) if len(values) in (9, 12) else values.reshape(4, 4)
            fx, fy, cx, cy, skew = matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2], matrix[0, 1]
        return name, checks.intrinsics(float(fx), float(fy), float(cx), float(cy), name, skew=float(skew)), size
    return None
