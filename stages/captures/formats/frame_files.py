"""A frame of a `transforms.json` with the mask and depth map that it names, and the cloud of points of the whole file."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ....pipeline import CaptureError
from ....vision.depth.files import SUFFIXES
from .. import checks
from ..ply_points import add_points
from ..posed.finding import is_absolute
from ..reading import Reading, Shot
from . import transforms

DEPTH = ("depth_file_path", "depth_path")  # nerfstudio; instant-ngp and NeRFCapture
_LONGEST = 4096


def shot_of(
    root: Path, frame: dict[str, Any], data: dict[str, Any], where: str, picture: str, size: tuple[int, int], said: list[str], **placed: Any
) -> Shot:
    """The shot of a frame of a file with ``data``, with its `picture` of `size`, lens, pose, mask and depth map. said: see
    `transforms.lens`. placed: camera, time, and what else the layout says."""
    lens = transforms.lens(frame, data, where, root, picture, size, said)
    return Shot(
        name=picture,
        size=size,
        file=picture,
        keep=_mask_of(root, frame, where),
        depth=_depth_of(root, frame, where),
        K=lens.K,
        cam_from_world=transforms.pose(frame, where),
        distortion=lens.distortion,
        fisheye=lens.fisheye,
        **placed,
    )


def _mask_of(root: Path, frame: dict[str, Any], where: str) -> str | None:
    """The file that `mask_path` names. Raises CaptureError if there is none."""
    field, raw = f"{where}: mask_path", frame.get("mask_path")
    if raw is None:
        return None
    name = checks.text(raw, field)
    return _inside(root, name, field, ("", *checks.IMAGE_SUFFIXES)) or checks.find_image(root, name, field)


def _depth_of(root: Path, frame: dict[str, Any], where: str) -> str | None:
    """The depth map that the frame names, which may lack its suffix; None if there is no such file. Its unit
    (`depth_unit_scale_factor`) does not matter: depth is fitted to known points."""
    for key in DEPTH:
        if frame.get(key) is not None:
            return _inside(root, checks.text(frame[key], f"{where}: {key}"), f"{where}: {key}", ("", *SUFFIXES))
    return None


def lost_depth(frames: Sequence[dict[str, Any]], shots: Sequence[Shot]) -> tuple[str, ...]:
    """A line if depth maps that ``frames`` name are not there. shots: those of ``frames``."""
    named = [shot.depth for frame, shot in zip(frames, shots, strict=True) if any(frame.get(key) is not None for key in DEPTH)]
    lost = sum(depth is None for depth in named)
    return (f"{lost} of {len(named)} depth maps that frames name are not there (depth_file_path)",) if lost else ()


def add_cloud(reading: Reading, root: Path, data: dict[str, Any], file: str) -> None:
    """Gives ``reading`` the points of the file that `ply_file_path` names, or a note if it does not exist. nerfstudio stores the points in
    the world of `transform_matrix`: both already include `applied_transform`, which maps COLMAP's world to it."""
    field, raw = f"{file}: ply_file_path", data.get("ply_file_path")
    if raw is None:
        return
    name = checks.text(raw, field)
    if (found := _inside(root, name, field)) is not None:
        add_points(reading, root, found)
    else:
        reading.notes += (f"{field}: no file {name[:200]!r}, so training begins at points that are triangulated; copy it if there is one",)


def _inside(root: Path, raw: str, field: str, suffixes: Sequence[str] = ("",)) -> str | None:
    """The file that a path names, relative to the capture: as it is written, or by its end if it is an absolute path of another place. None
    if there is none. Raises CaptureError for a path that leaves the capture."""
    name = raw.replace("\\", "/")
    try:
        return _file(root, checks.relative(root, name, field), field, suffixes)
    except CaptureError:
        parts = [part for part in name.split("/") if part not in ("", ".")]
        if not is_absolute(name) or ".." in parts or len(name) > _LONGEST:
            raise
        ends = ("/".join(parts[cut:]) for cut in range(1, len(parts)))
        return next((path for end in ends if (path := _file(root, end, field, suffixes))), None)


def _file(root: Path, name: str, field: str, suffixes: Sequence[str]) -> str | None:
    return next((name + suffix for suffix in suffixes if checks.resolve_inside(root, name + suffix, field).is_file()), None)
