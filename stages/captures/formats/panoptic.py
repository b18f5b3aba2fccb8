"""CMU Panoptic as prepared by Dynamic 3D Gaussians: `train_meta.json`, `test_meta.json`, `ims/`, `seg/`.

`k[t][c]`, `w2c[t][c]` (OpenCV `cam_from_world`), `fn[t][c]`, `cam_id[t][c]`, and `w`, `h`. K is used unchanged, with pixel
centres at +0.5, as the authors of the files use it for rendering. If the calibration meant integer centres, the error would
be at most half a pixel of its own resolution.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ....pipeline import CaptureError
from .. import checks
from ..arrays import load_array
from ..posed.finding import find_pictures_of_splits
from ..posed.sizes import scale_of
from ..reading import TEST, TRAIN, Options, Reading, Shot
from ..rigs import all_fixed

_FILES = ((TRAIN, "train_meta.json"), (TEST, "test_meta.json"))
_POINTS = "init_pt_cld.npz"


def detect(root: Path) -> str | None:
    return "train_meta.json" if (root / "train_meta.json").is_file() else None


def read(root: Path, options: Options) -> Reading:
    sizes: list[tuple[float, float]] = []
    entries: dict[str, list[_Entry]] = {}
    for _, file in _FILES:
        if not (root / file).is_file():
            raise CaptureError(f"{file}: missing beside train_meta.json; copy it into {root}")
        data = checks.read_json(root, file)
        sizes.append((checks.number(data.get("w"), f"{file}: w", 1, 1e6), checks.number(data.get("h"), f"{file}: h", 1, 1e6)))
        entries[file] = _entries(file, data)
    names = {file: {i: (one.name, f"{one.where}: fn") for i, one in enumerate(own)} for file, own in entries.items()}
    found = find_pictures_of_splits(root, _FILES[0][1], names, "pictures", "ims/")
    shots = [_shot(root, entries[file][i], image, split) for split, file in _FILES for i, image in found[file].paths.items()]
    shots.sort(key=lambda s: (s.camera, s.time))
    headers, alpha = checks.image_headers(root, [str(s.file) for s in shots])
    for shot, (width, height) in zip(shots, headers, strict=True):
        shot.size = width, height
        where = f"{_FILES[shot.split == TEST][1]}: w, h say"
        sx, sy = scale_of(root, str(shot.file), shot.size, sizes[0 if shot.split == TRAIN else 1], where)
        if shot.K is not None:
            shot.K = np.diag([sx, sy, 1.0]) @ shot.K
    points, colors = _points(root)
    return Reading(
        why="train_meta.json + test_meta.json",
        shots=shots,
        alpha=alpha,
        has_split=bool(found[_FILES[1][1]].paths),
        fixed_cameras=all_fixed(shots),
        sources=(*found, *([_POINTS] if points is not None else [])),
        points=points,
        point_colors=colors,
        notes=tuple(note for one in found.values() for note in one.notes),
    )


class _Entry(NamedTuple):
    """A frame as its file has it. where: for messages."""

    time: int
    where: str
    name: str
    K: Any
    pose: Any
    camera: Any


def _entries(file: str, data: dict[str, Any]) -> list[_Entry]:
    table = {key: checks.items(data.get(key), f"{file}: {key}") for key in ("k", "w2c", "fn", "cam_id")}
    lengths = {key: len(value) for key, value in table.items()}
    if len(set(lengths.values())) != 1:
        raise CaptureError(f"{file}: k, w2c, fn and cam_id differ in their number of times ({lengths}); the file is damaged")
    entries = []
    for t in range(lengths["fn"]):
        row = {key: checks.items(value[t], f"{file}: {key}[{t}]") for key, value in table.items()}
        counts = {key: len(value) for key, value in row.items()}
        if len(set(counts.values())) != 1:
            raise CaptureError(f"{file}: time {t}: k, w2c, fn and cam_id differ in their number of cameras ({counts}); the file is damaged")
        for c in range(counts["fn"]):
            where = f"{file}: time {t}, camera {c}"
            name = checks.text(row["fn"][c], f"{where}: fn")
            entries.append(_Entry(t, where, name, row["k"][c], row["w2c"][c], row["cam_id"][c]))
    return entries


def _shot(root: Path, entry: _Entry, image: str, split: int) -> Shot:
    where = entry.where
    K = checks.matrix(entry.K, f"{where}: k", ((3, 3),))
    mask = ("seg/" + entry.name).rsplit(".", 1)[0] + ".png"
    return Shot(
        name=image,
        camera=checks.integer(entry.camera, f"{where}: cam_id", 0, 10**6),
        time=float(entry.time),
        size=(0, 0),  # set by `read`, which reads all image headers together
        split=split,
        file=image,
        mask=mask if (root / mask).is_file() else None,
        K=checks.intrinsics(K[0, 0], K[1, 1], K[0, 2], K[1, 2], f"{where}: k", skew=K[0, 1]),
        cam_from_world=checks.rigid(checks.matrix(entry.pose, f"{where}: w2c", ((4, 4), (3, 4))), f"{where}: w2c"),
    )


def _points(root: Path) -> tuple[np.ndarray | None, np.ndarray | None]:
    """Points and colours of `init_pt_cld.npz`: `data` [P, 6 or 7] = xyz, rgb in [0,1], segmentation label."""
    if not (root / _POINTS).is_file():
        return None, None
    data = load_array(root, _POINTS, (6, 7), "data")
    bad = np.flatnonzero(~(np.abs(data[:, :6]) < 1e12).all(1))
    if len(bad):
        raise CaptureError(
            f"{_POINTS}: data: point {bad[0]}: {data[bad[0], :6].tolist()} is not a valid position and colour; remove it, or the file"
        )
    if not len(data):
        return None, None
    return data[:, :3].copy(), np.clip(np.rint(data[:, 3:6] * 255), 0, 255).astype(np.uint8)
