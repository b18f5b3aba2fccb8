"""Nerfies, HyperNeRF and DyCheck: `dataset.json` (splits), `metadata.json` (times), `camera/<id>.json`, `rgb/<scale>x/<id>.png`, and
`scene.json`.

A camera file has `orientation` (world to camera, OpenCV axes), `position` (the camera centre in the world), and OpenCV's lens parameters
for pictures of `image_size`, pixel centres at +0.5. Pictures in `rgb/4x` are a quarter of that size. World positions x of the files are
transformed to (x - center) * scale, with center and scale from `scene.json`. The format is documented in the README and camera.py of
github.com/google/nerfies.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ....pipeline import CaptureError
from .. import checks
from ..arrays import load_array
from ..lens import LARGEST_TERM, Lens, distortion_of
from ..posed.depth import told_depth
from ..posed.finding import find_pictures
from ..posed.sizes import scale_of
from ..reading import TRAIN, VAL, Options, Reading, Shot

_DATASET, _METADATA, _SCENE, _POINTS = "dataset.json", "metadata.json", "scene.json", "points.npy"
_SPLITS = ((TRAIN, "train_ids"), (VAL, "val_ids"))
_GREY = 128  # the points have no colours
# Folders that DyCheck adds (github.com/KAIR-BAIR/dycheck, docs/DATASETS.md).
_UNREAD = {
    "covisible": "metrics count all pixels, not only those that training views see (covisibility masks)",
    "keypoint": "keypoints are not evaluated",
    "flow": "optical flow is measured instead",
    "splits": "the splits are those of dataset.json",
}
_FAR = 1e9  # world units; larger positions are errors


def detect(root: Path) -> str | None:
    there = (root / _DATASET).is_file() and (root / "camera").is_dir()
    return f"{_DATASET} and camera/" if there else None


def read(root: Path, options: Options) -> Reading:
    if detect(root) is None:
        raise CaptureError(f"{root}: no {_DATASET} beside camera/, which the Nerfies layout needs; pass its folder or another --format")
    split = _ids(checks.read_json(root, _DATASET))
    metadata = checks.read_json(root, _METADATA) if (root / _METADATA).is_file() else {}
    moment = _moment(metadata, split)
    center, scale = _scene(root)
    folder = _folder(root, next(iter(split)), options.size_limit)
    ids = list(split)
    found = find_pictures(root, {i: (name, f"{_DATASET}: {name!r}") for i, name in enumerate(ids)}, _DATASET, "ids", f"{folder}/")
    images = {ids[i]: path for i, path in found.paths.items()}
    sizes, alpha = checks.image_headers(root, images.values())
    shots, cameras = [], []
    for (name, image), size in zip(images.items(), sizes, strict=True):
        file = f"camera/{name}.json"
        if not checks.resolve_inside(root, file, file).is_file():
            raise CaptureError(f"{file}: missing, but {_DATASET} lists {name!r}; copy it, or take {name!r} out of the lists")
        data = checks.read_json(root, file)
        where = f"{_METADATA}: {name!r}"
        entry = metadata.get(name)
        time = checks.number(entry[moment], f"{where}: {moment}", 0, 1e9) if moment and isinstance(entry, dict) else 0.0
        camera = checks.integer(entry.get("camera_id", 0), f"{where}: camera_id", 0, 10**6) if isinstance(entry, dict) else 0
        shot = Shot(name=image, camera=camera, time=time, size=size, split=split[name], file=image)
        shot.cam_from_world = _pose(data, file, center, scale)
        shot.K, shot.distortion, shot.fisheye = _lens(data, file, root, image, size)
        shots.append(shot)
        cameras.append(file)
    shots.sort(key=lambda s: (s.time, s.camera, checks.natural_key(s.name)))
    if moment is None:
        for rank, shot in enumerate(shots):
            shot.time = float(rank)
    points = _cloud(root, center, scale)
    sources = [_DATASET, *(f for f in (_METADATA, _SCENE) if (root / f).is_file()), *cameras, *([_POINTS] if points is not None else [])]
    return Reading(
        why=f"{_DATASET}, camera/ and {folder}, {len({s.camera for s in shots})} moving camera(s), times from {moment or 'the names'}",
        shots=shots,
        alpha=alpha,
        has_split=any(s.split == VAL for s in shots),
        sources=tuple(sources),
        points=points,
        point_colors=None if points is None else np.full(points.shape, _GREY, np.uint8),
        notes=(*found.notes, *_unread(root)),
        depth_notes=told_depth(root, [name for name in ("depth",) if (root / name).is_dir()]),
        spoken_for=tuple(name for name in ("depth", *_UNREAD) if (root / name).is_dir()),
    )


def _unread(root: Path) -> tuple[str, ...]:
    """Notes about what DyCheck has beside the files of Nerfies."""
    return tuple(f"{name}/ is not read: {what}" for name, what in _UNREAD.items() if (root / name).is_dir())


def _ids(data: dict[str, Any]) -> dict[str, int]:
    """Split of each id, train before val, in the order of the lists."""
    result: dict[str, int] = {}
    for split, field in _SPLITS:
        if split == VAL and not data.get(field):
            continue
        for i, raw in enumerate(checks.items(data.get(field), f"{_DATASET}: {field}")):
            where = f"{_DATASET}: {field}[{i}]"
            name = str(raw) if isinstance(raw, int) and not isinstance(raw, bool) else checks.text(raw, where)
            if not re.fullmatch(r"[\w.\- ]{1,200}", name) or name in (".", ".."):
                raise CaptureError(f"{where}: {name[:200]!r} is not a file name; rename the files and correct the lists")
            if name in result:
                raise CaptureError(f"{where}: {name!r} is listed twice; list each id once, in train_ids or in val_ids")
            result[name] = split
    return result


def _moment(metadata: dict[str, Any], names: Sequence[str] | dict[str, int]) -> str | None:
    """The field of metadata.json that gives the time; None without metadata, so that the order of the names is used."""
    if not metadata:
        return None
    for name in names:
        if not isinstance(metadata.get(name), dict):
            raise CaptureError(
                f"{_METADATA}: {name!r}: expected an object with warp_id or time_id; add it, or take the id out of {_DATASET}"
            )
    for field in ("time_id", "warp_id"):
        missing = [name for name in names if metadata[name].get(field) is None]
        if not missing:
            return field
    raise CaptureError(f"{_METADATA}: {missing[0]!r}: warp_id is missing, and so is a time_id for all; add either to every id")


def _scene(root: Path) -> tuple[np.ndarray, float]:
    """(center [3], scale) of scene.json; without that file, zero and one."""
    if not (root / _SCENE).is_file():
        return np.zeros(3), 1.0
    data = checks.read_json(root, _SCENE)
    scale = checks.number(data.get("scale", 1.0), f"{_SCENE}: scale", 1e-9, 1e9)
    return np.array(checks.numbers(data.get("center", [0, 0, 0]), f"{_SCENE}: center", (3,), _FAR)), scale


def _folder(root: Path, name: str, max_size: int | None) -> str:
    """The folder of the finest scale, usually rgb/1x; with `max_size`, the coarsest whose pictures are not smaller than that."""
    scales = sorted(
        int(folder[:-1])
        for folder in (checks.list_folder(root / "rgb") if (root / "rgb").is_dir() else [])
        if re.fullmatch(r"[1-9]\d{0,3}x", folder) and (root / "rgb" / folder).is_dir()
    )
    if not scales:
        raise CaptureError(f"{root}: no rgb/1x, rgb/2x, ... with the images; copy at least one of them")
    chosen = scales[0]
    for scale in scales[1:] if max_size else []:
        image = checks.seek_image(root, f"rgb/{scale}x/{name}", f"rgb/{scale}x")
        if image is not None and max(checks.image_header(root, image)[:2]) >= (max_size or 0):
            chosen = scale
    return f"rgb/{chosen}x"


def _pose(data: dict[str, Any], file: str, center: np.ndarray, scale: float) -> np.ndarray:
    turn = np.eye(4)
    turn[:3, :3] = checks.matrix(data.get("orientation"), f"{file}: orientation", ((3, 3),))
    result = checks.rigid(turn, f"{file}: orientation")
    position = np.array(checks.numbers(data.get("position"), f"{file}: position", (3,), _FAR))
    result[:3, 3] = -result[:3, :3] @ ((position - center) * scale)
    return checks.rigid(result, f"{file}: position")


def _lens(data: dict[str, Any], file: str, root: Path, picture: str, size: tuple[int, int]) -> Lens:
    """The lens, with K for a picture of `size`."""
    width, height = checks.numbers(data.get("image_size"), f"{file}: image_size", (2,), 1e6)
    if min(width, height) < 1:
        raise CaptureError(f"{file}: image_size: {width:g}x{height:g} makes no sense; correct the file")
    sx, sy = scale_of(root, picture, size, (width, height), f"{file}: image_size says")
    focal = checks.number(data.get("focal_length"), f"{file}: focal_length", 1e-3, 1e7)
    ratio = checks.number(data.get("pixel_aspect_ratio", 1.0), f"{file}: pixel_aspect_ratio", 0.01, 100)
    cx, cy = checks.numbers(data.get("principal_point"), f"{file}: principal_point", (2,), 1e6)
    skew = checks.number(data.get("skew", 0.0), f"{file}: skew")
    radial = checks.numbers(data.get("radial_distortion", [0, 0, 0]), f"{file}: radial_distortion", (2, 3), LARGEST_TERM)
    field = "tangential_distortion" if "tangential_distortion" in data else "tangential"
    tangential = checks.numbers(data.get(field, [0, 0]), f"{file}: {field}", (2,), LARGEST_TERM)
    K = checks.intrinsics(focal * sx, focal * ratio * sy, cx * sx, cy * sy, file, skew=skew * sx)
    return Lens(K, distortion_of([*radial[:2], *tangential, *radial[2:]]))


def _cloud(root: Path, center: np.ndarray, scale: float) -> np.ndarray | None:
    """Points [P,3] of points.npy in world units; None without the file or without points."""
    if not (root / _POINTS).is_file():
        return None
    points = load_array(root, _POINTS, (3,))
    bad = np.flatnonzero(~(np.abs(points) <= _FAR).all(1))
    if len(bad):
        raise CaptureError(f"{_POINTS}: point {bad[0]}: {points[bad[0]].tolist()} is not a valid position; remove it, or the file")
    return (points - center) * scale if len(points) else None
