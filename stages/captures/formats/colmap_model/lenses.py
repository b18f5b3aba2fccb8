"""`lens_of`: the lens of a COLMAP camera for one picture."""

from __future__ import annotations

from pathlib import Path

from .....pipeline import CaptureError
from ... import checks
from ...lens import LARGEST_TERM, Lens, distortion_of
from ...posed.sizes import scale_of
from .records import LAYOUT, CameraRecord, refusal


def lens_of(camera: CameraRecord, where: str, root: Path, picture: str, size: tuple[int, int]) -> Lens:
    """``where``: the file and the camera, for messages. Raises CaptureError for models that are not supported and for bad numbers."""
    model, file_width, file_height, values = camera
    if model not in LAYOUT:
        raise CaptureError(f"{where}: {refusal(model)}")
    one_focal, count = LAYOUT[model]
    if len(values) != 4 - one_focal + count:
        raise CaptureError(f"{where}: {len(values)} parameters, but {model} has {4 - one_focal + count}; export the model again")
    numbers = [checks.number(value, f"{where}: parameter {i}") for i, value in enumerate(values)]
    fx, fy, cx, cy, *terms = numbers[:1] * one_focal + numbers
    for i, term in enumerate(terms, len(values) - count):
        checks.number(term, f"{where}: parameter {i}", -LARGEST_TERM, LARGEST_TERM)
    checks.number(file_width, f"{where}: width", 1, 1e6)
    checks.number(file_height, f"{where}: height", 1, 1e6)
    sx, sy = scale_of(root, picture, size, (file_width, file_height), f"{where}: made for")
    fisheye = model.endswith("FISHEYE")
    return Lens(checks.intrinsics(fx * sx, fy * sy, cx * sx, cy * sy, where), distortion_of(terms), fisheye)
