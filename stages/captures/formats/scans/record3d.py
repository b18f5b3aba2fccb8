"""Record3D's raw export: `metadata.json` (in .r3d files `metadata`) and `rgb/` or `rgbd/` with `0.jpg`, `1.jpg`, ...

`poses` has [qx, qy, qz, qw, tx, ty, tz] for each frame: camera to world, OpenGL axes. `K` lists a 3x3 matrix column by column, for pictures
of `w` x `h`; `perFrameIntrinsicCoeffs` has [fx, fy, cx, cy] for each frame. Facts from github.com/nerfstudio-project/nerfstudio
(process_data/record3d_utils.py), github.com/NVlabs/instant-ngp (scripts/record3d2nerf.py) and the app's exports.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np

from .....pipeline import CaptureError
from ... import checks
from ...posed.depth import told_depth
from ...posed.rotations import rotation
from ...posed.sizes import scale_of
from ...posed.stated import states_layout
from ...reading import Options, Reading, Shot
from ..transforms import OPENCV_FROM_OPENGL

_FILES = ("metadata.json", "metadata")
_FOLDERS = ("rgb", "rgbd", "images", "color")
_UNREAD = (".depth", ".conf", ".exr")


def detect(root: Path) -> str | None:
    file, folder = _file(root), _folder(root)
    if file is None or folder is None or states_layout(root):  # Nerfies has a metadata.json as well
        return None
    try:
        data = checks.read_json(root, file)
    except CaptureError:
        return f"{file} and {folder}/"  # reading it says what is wrong
    return f"{file} of Record3D and {folder}/" if "poses" in data or {"K", "w", "h"} <= set(data) else None


def read(root: Path, options: Options) -> Reading:
    file, folder = _file(root), _folder(root)
    if file is None or folder is None:
        raise CaptureError(f"{root}: no metadata.json beside rgb/ or rgbd/, which a Record3D export has; pass its folder")
    data = checks.read_json(root, file)
    if not data.get("poses"):
        raise CaptureError(
            f"{file}: no poses (a list of [qx, qy, qz, qw, tx, ty, tz]); export the recording again with its poses, or give {folder}/ "
            "itself to have poses estimated"
        )
    poses = checks.items(data["poses"], f"{file}: poses")
    w, h = (checks.integer(data.get(key), f"{file}: {key}", 1, 10**6) for key in ("w", "h"))
    fps = None if data.get("fps") is None else checks.number(data["fps"], f"{file}: fps", 1e-3, 1e6)
    pictures, gone = _pictures(root, folder, len(poses), file)
    sizes, alpha = checks.image_headers(root, pictures.values())
    lenses, seconds = _rows(data, "perFrameIntrinsicCoeffs", len(poses), file), _rows(data, "frameTimestamps", len(poses), file)
    shared = None if lenses is not None else _matrix(data.get("K"), f"{file}: K")
    shots = []
    for (i, picture), size in zip(pictures.items(), sizes, strict=True):
        where = f"{file}: poses[{i}]"
        qx, qy, qz, qw, *centre = checks.numbers(poses[i], where, (7,))
        world_from_cam = np.eye(4)
        world_from_cam[:3, :3] = rotation((qw, qx, qy, qz), where)
        world_from_cam[:3, 3] = centre
        shot = Shot(name=picture, camera=0, time=float(i), size=size, file=picture)
        shot.cam_from_world = checks.inverse(checks.rigid(world_from_cam, where) @ OPENCV_FROM_OPENGL)
        K = shared if lenses is None else _lens(lenses[i], f"{file}: perFrameIntrinsicCoeffs[{i}]")
        shot.K = np.diag([*scale_of(root, picture, size, (w, h), f"{file}: w, h say"), 1.0]) @ K
        if seconds is not None:
            shot.time = checks.number(seconds[i], f"{file}: frameTimestamps[{i}]")
        shots.append(shot)
    if seconds is not None:
        begin = min(shot.time for shot in shots)
        for shot in shots:
            shot.seconds = shot.time - begin
    unread = _unread(root, folder)
    return Reading(
        why=f"{file} of Record3D and {folder}/, one moving camera",
        shots=shots,
        alpha=alpha,
        fps=fps,
        sources=(file,),
        notes=gone,
        depth_notes=told_depth(root, unread),
        spoken_for=unread,
    )


def _file(root: Path) -> str | None:
    """metadata.json, also if it is no file and reading it says so; "metadata" may be a folder of other captures."""
    return _FILES[0] if os.path.lexists(root / _FILES[0]) else _FILES[1] if (root / _FILES[1]).is_file() else None


def _folder(root: Path) -> str | None:
    for name in _FOLDERS:
        if (root / name).is_dir() and any(n.lower().endswith((".jpg", ".jpeg", ".png")) for n in checks.list_folder(root / name)):
            return name
    return None


def _pictures(root: Path, folder: str, count: int, file: str) -> tuple[dict[int, str], tuple[str, ...]]:
    """The picture of each pose by its index, which is the number in its name, and a note about missing ones."""
    names = [n for n in checks.list_folder(root / folder) if n.lower().endswith(checks.IMAGE_SUFFIXES) and (root / folder / n).is_file()]
    jpeg = [n for n in names if n.lower().endswith((".jpg", ".jpeg"))]
    names = jpeg or names  # beside them, PNG files are depth maps
    stems = [n.rsplit(".", 1)[0] for n in names]
    if not all(stem.isascii() and stem.isdecimal() and len(stem) < 10 for stem in stems):
        if len(names) != count:
            raise CaptureError(
                f"{folder}/: {len(names)} pictures for {count} poses of {file}, and their names are no numbers; rename or add them"
            )
        return {i: f"{folder}/{name}" for i, name in enumerate(names)}, ()
    numbers = [int(stem) for stem in stems]
    first = 1 if numbers == list(range(1, count + 1)) else 0
    found = {n - first: f"{folder}/{name}" for n, name in zip(numbers, names, strict=True) if 0 <= n - first < count}
    for name in found.values():
        checks.resolve_inside(root, name, name)
    beyond, gone = len(names) - len(found), [i for i in range(count) if i not in found]
    if 2 * len(gone) > count:
        raise CaptureError(f"{file}: {len(gone)} of {count} poses have no picture (first {folder}/{gone[0] + first}.jpg); add the files")
    notes = (
        [f"{len(gone)} of {count} poses of {file} have no picture and are left out; first {folder}/{gone[0] + first}.jpg"] if gone else []
    )
    return found, (*notes, *([f"{beyond} pictures of {folder}/ have no pose in {file} and are left out"] if beyond else []))


def _rows(data: dict[str, Any], key: str, count: int, file: str) -> list[Any] | None:
    if not data.get(key):
        return None
    rows = checks.items(data[key], f"{file}: {key}")
    if len(rows) != count:
        raise CaptureError(f"{file}: {key}: {len(rows)} entries for {count} poses; correct the file")
    return rows


def _lens(value: Any, where: str) -> np.ndarray:
    fx, fy, cx, cy = checks.numbers(value, where, (4,))
    return checks.intrinsics(fx, fy, cx, cy, where)


def _matrix(value: Any, where: str) -> np.ndarray:
    """K from nine numbers or three rows of three. Record3D lists columns; where the last column holds cx, cy, they are rows."""
    flat = [v for row in value for v in (row if isinstance(row, list) else [row])] if isinstance(value, list) else value
    matrix = np.reshape(checks.numbers(flat, where, (9,)), (3, 3))
    if matrix[0, 2] == matrix[1, 2] == 0:
        matrix = matrix.T
    return checks.intrinsics(matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2], where, skew=matrix[0, 1])


def _unread(root: Path, folder: str) -> tuple[str, ...]:
    names = checks.list_folder(root / folder)
    jpeg = any(n.lower().endswith((".jpg", ".jpeg")) for n in names)
    files = [f"{folder}/{n}" for n in names if n.lower().endswith((*_UNREAD, *((".png",) if jpeg else ())))]
    return (*(name for name in ("depth", "confidence", "conf") if (root / name).is_dir()), *files)
