"""Checks that every reader applies to a capture's files before it trusts them: paths stay inside, numbers are finite, poses are rigid.

Each function raises `CaptureError` with a message that names the file, the frame and the field, and says what to do.
"""

from __future__ import annotations

import gc
import json
import math
import os
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ...pipeline import CaptureError
from ...pipeline.errors import is_odd
from ...vision.images.files import LYING as LYING
from ...vision.images.files import BadImageError, open_image, orientation_of, stored_size
from .listing import refusals
from .listing.names import IMAGE_SUFFIXES as IMAGE_SUFFIXES
from .listing.names import VIDEO_SUFFIXES as VIDEO_SUFFIXES
from .listing.names import find_image as find_image
from .listing.names import in_order
from .listing.names import natural_key as natural_key
from .listing.names import relative as relative
from .listing.names import resolve_inside as resolve_inside
from .listing.names import seek_image as seek_image
from .listing.tree import is_foreign as is_foreign

_JSON_LIMIT = 64 * 2**20  # 1 kB per frame is usual; millions of empty lists take seconds and gigabytes to parse
_MOST_BYTES = 64 * 2**30  # COLMAP's images file for ten thousand photos with all their features has half of this
_FARTHEST = 1e12  # world units from the origin
_RIGID_TOLERANCE = 1e-3


def refuse_odd_names(names: Iterable[str]) -> None:
    """Refuses names that are not plain text: with line breaks, control characters, or bytes that are not UTF-8. They could neither be shown
    on one line nor be written into a result."""
    for name in names:
        if any(map(is_odd, name)):
            raise CaptureError(f"{name!r}: a name with control characters or bytes that are not UTF-8; rename the file")


def refuse_huge_files(root: Path, names: Iterable[str]) -> None:
    """Refuses files larger than any camera, model or point cloud file. Every command reads the whole capture to see whether it changed."""
    for name in names:
        try:
            size = (root / name).stat().st_size
        except OSError as error:
            raise CaptureError(f"{name}: cannot be read ({error.strerror}); check the file and its permissions") from error
        if size > _MOST_BYTES:
            raise CaptureError(f"{name}: {size / 1e9:.0f} GB, which is too large for a capture; copy the file again or remove it")


def list_folder(folder: Path) -> list[str]:
    """Names in `folder` that are not hidden, in the order of `names.in_order`."""
    try:
        names = os.listdir(folder)
    except OSError as error:
        raise CaptureError(f"{folder}: cannot be listed ({error.strerror}); check the path and its permissions") from error
    return in_order(n for n in names if not n.startswith("."))


def list_files(folder: Path) -> list[str]:
    """Like `list_folder`, but only files, and links to files."""
    try:
        with os.scandir(folder) as entries:
            return in_order(entry.name for entry in entries if not entry.name.startswith(".") and _is_file(entry))
    except OSError as error:
        raise CaptureError(f"{folder}: cannot be listed ({error.strerror}); check the path and its permissions") from error


def _is_file(entry: os.DirEntry[str]) -> bool:
    try:
        return entry.is_file()
    except OSError:  # links in a circle
        return False


def read_json(root: Path, name: str) -> dict[str, Any]:
    """The JSON object in `root/name`. Refuses other top-level types, broken text, duplicate names in an object, and files over 64 MiB."""
    path = root / name
    resolve_inside(root, name, name)
    try:
        if path.stat().st_size > _JSON_LIMIT:
            raise CaptureError(f"{name}: larger than 64 MiB, so it is not a camera file; check the capture")
        data = _parsed(path.read_bytes().decode("utf-8-sig"))
    except UnicodeDecodeError as error:
        raise CaptureError(f"{name}: not UTF-8 (byte {error.start}); save the file as UTF-8") from error
    except (ValueError, RecursionError) as error:
        raise CaptureError(f"{name}: not valid JSON ({error}); the file may be cut short, copy it again") from error
    except OSError as error:
        raise CaptureError(f"{name}: cannot be read ({error.strerror}); check the file and its permissions") from error
    if not isinstance(data, dict):
        raise CaptureError(f"{name}: expected a JSON object at the top, found {_kind(data)}; see the format's documentation")
    return data


def _parsed(text: str) -> Any:
    """The JSON in `text`. Raises ValueError, also for a duplicate name in an object, of which the last would silently win."""

    def unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        found = dict(pairs)
        if len(found) < len(pairs):
            names = [key for key, _ in pairs]
            raise ValueError(f"the name {next(key for key in names if names.count(key) > 1)[:100]!r} appears twice in one object")
        return found

    collecting = gc.isenabled()
    gc.disable()  # else it scans everything parsed so far again and again, which takes 20 times as long for millions of small lists
    try:
        return json.loads(text, object_pairs_hook=unique)
    finally:
        if collecting:
            gc.enable()


def number(value: Any, where: str, low: float = -1e12, high: float = 1e12) -> float:
    """`value` as a finite float in [low, high]. Booleans and strings are not numbers."""
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise CaptureError(f"{where}: expected a number, found {_kind(value)}; correct the file")
    try:
        result = float(value)
    except OverflowError:
        result = math.inf
    if not math.isfinite(result):
        raise CaptureError(f"{where}: not a finite number; correct the file or remove the frame")
    if not low <= result <= high:
        raise CaptureError(f"{where}: {result:g} lies outside [{low:g}, {high:g}]; correct the file")
    return result


def integer(value: Any, where: str, low: int, high: int) -> int:
    result = number(value, where, low, high)
    if result != int(result):
        raise CaptureError(f"{where}: expected a whole number, found {result:g}; correct the file")
    return int(result)


def text(value: Any, where: str) -> str:
    if not isinstance(value, str) or not value.strip():
        raise CaptureError(f"{where}: expected a non-empty string, found {_kind(value)}; correct the file")
    return value


def numbers(value: Any, where: str, counts: tuple[int, ...], most: float = 1e12) -> list[float]:
    """A list of as many numbers as one of ``counts``, each in [-most, most]."""
    if not isinstance(value, list) or len(value) not in counts:
        found = f"{len(value)} entries" if isinstance(value, list) else _kind(value)
        raise CaptureError(f"{where}: expected a list of {' or '.join(map(str, counts))} numbers, found {found}; correct the file")
    return [number(v, f"{where}[{i}]", -most, most) for i, v in enumerate(value)]


def items(value: Any, where: str) -> list[Any]:
    if not isinstance(value, list) or not value:
        raise CaptureError(f"{where}: expected a non-empty list, found {_kind(value)}; correct the file")
    return value


def matrix(value: Any, where: str, shapes: Sequence[tuple[int, int]]) -> np.ndarray:
    """`value` (nested lists) as a float64 array with one of `shapes`, every entry finite."""
    expected = " or ".join(f"{r}x{c}" for r, c in shapes)
    if not isinstance(value, list) or not all(isinstance(row, list) for row in value):
        raise CaptureError(f"{where}: expected a {expected} matrix, found {_kind(value)}; correct the file")
    widths = {len(row) for row in value}
    if len(widths) != 1 or (len(value), next(iter(widths))) not in shapes:
        raise CaptureError(f"{where}: expected a {expected} matrix, found {len(value)} rows of {sorted(widths)} numbers; correct the file")
    return np.array([[number(v, f"{where}[{r}][{c}]") for c, v in enumerate(row)] for r, row in enumerate(value)], dtype=np.float64)


def rigid(pose: np.ndarray, where: str) -> np.ndarray:
    """A rigid transform [3,4] or [4,4] as [4,4] float64 with an exactly orthonormal rotation. Refuses scale, shear and mirroring."""
    result = np.eye(4)
    result[:3, :4] = pose[:3, :4]
    if not np.isfinite(result).all():
        raise CaptureError(f"{where}: holds NaN or Inf; remove the frame or estimate its pose again")
    if np.abs(result[:3, 3]).max() > _FARTHEST:
        raise CaptureError(f"{where}: the camera stands more than {_FARTHEST:g} world units away; correct the file")
    if pose.shape[0] == 4 and np.abs(pose[3] - [0, 0, 0, 1]).max() > 1e-6:
        raise CaptureError(
            f"{where}: the last row is {pose[3].tolist()}, not [0, 0, 0, 1]; this is not a camera pose (perhaps it is transposed)"
        )
    rotation = result[:3, :3]
    error = np.abs(rotation.T @ rotation - np.eye(3)).max() if np.abs(rotation).max() < 1e3 else np.inf
    if error > _RIGID_TOLERANCE or np.linalg.det(rotation) < 0:
        reason = "mirrors" if error <= _RIGID_TOLERANCE else f"is {error:.2g} away from a rotation"
        raise CaptureError(f"{where}: the 3x3 part {reason}, so the pose is not rigid; remove scale, shear and mirroring from the export")
    # Files store six or seven digits. The nearest rotation restores full precision, so that inverse and transpose agree later on.
    u, _, vt = np.linalg.svd(rotation)
    result[:3, :3] = u @ vt
    return result


def inverse(rigid_transform: np.ndarray) -> np.ndarray:
    """Inverse of a rigid [4,4] transform."""
    rotation = rigid_transform[:3, :3].T
    result = np.eye(4)
    result[:3, :3] = rotation
    result[:3, 3] = -rotation @ rigid_transform[:3, 3]
    return result


def intrinsics(fx: float, fy: float, cx: float, cy: float, where: str, skew: float = 0.0) -> np.ndarray:
    """K, [3,3] float64 px, pixel centres at +0.5. Refuses singular matrices and skew."""
    values = np.array([fx, fy, cx, cy, skew])
    if not np.isfinite(values).all():
        raise CaptureError(f"{where}: intrinsics hold NaN or Inf; correct the file")
    if min(fx, fy) <= 1e-6:
        raise CaptureError(f"{where}: focal lengths must be positive, found {fx:g}, {fy:g} px; correct the file")
    if abs(skew) > 1e-3 * max(fx, fy):
        raise CaptureError(f"{where}: skew {skew:g} is not supported; rectify the images first")
    return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]], dtype=np.float64)


PIXELS = ("1", "L", "LA", "P", "PA", "RGB", "RGBA", "CMYK", "YCbCr", "I;16", "I;16B", "I;16L")  # Pillow modes that `read_picture` takes


def image_header(root: Path, name: str) -> tuple[int, int, bool]:
    """(width, height, has alpha) from the header of one image, as stored; nothing is decoded."""
    return _header(root, name, turn=False)[:3]


def _header(root: Path, name: str, turn: bool) -> tuple[int, int, bool, int]:
    """As `image_header`, and the EXIF orientation; 1 without `turn`, which takes longer."""
    try:
        with open_image(root / name) as image:
            width, height = stored_size(image)
            orientation = orientation_of(image) if turn else 1
            mode = image.mode
            alpha = "A" in image.getbands() or "transparency" in image.info
    except BadImageError as error:
        raise CaptureError(f"{name}: {refusals.of_picture(root / name, str(error))}") from error
    if mode not in PIXELS:
        raise CaptureError(f"{name}: pixels of kind {mode!r} are not supported; convert the images to RGB or RGBA of 8 or 16 bits")
    return width, height, alpha, orientation


def orientation(root: Path, name: str) -> int:
    """EXIF orientation of an image, 2 to 8; 1 if it is not to be rotated or mirrored."""
    try:
        with open_image(root / name) as image:
            return orientation_of(image)
    except BadImageError:
        return 1  # `image_header` reports what is wrong with it


def image_headers(root: Path, names: Iterable[str]) -> tuple[list[tuple[int, int]], bool]:
    """((width, height) of each of `names` as stored, whether any has alpha)."""
    headers = [_header(root, name, turn=False) for name in names]
    if not headers:
        raise CaptureError(f"{root}: holds no image")
    return [header[:2] for header in headers], any(header[2] for header in headers)


def upright_headers(root: Path, names: Iterable[str]) -> tuple[list[tuple[int, int]], bool, bool]:
    """As `image_headers`, but the sizes after the rotation that EXIF data ask for, and whether they ask for any rotation or mirroring, as
    those from a phone held upright do."""
    headers = [_header(root, name, turn=True) for name in names]
    sizes = [(height, width) if turn in LYING else (width, height) for width, height, _, turn in headers]
    return sizes, any(header[2] for header in headers), any(header[3] != 1 for header in headers)


def _kind(value: Any) -> str:
    if value is None:
        return "nothing (null)"
    return {dict: "an object", list: "a list", str: "a string", bool: "a boolean", int: "a number", float: "a number"}.get(
        type(value), type(value).__name__
    ) + (" without entries" if isinstance(value, (list, dict, str)) and not value else "")
