"""CMU Panoptic as prepared by Dynamic 3D Gaussians: `train_meta.json`, `test_meta.json`, `ims/`, `seg/`.

`k[t][c]`, `w2c[t][c]` (OpenCV `cam_from_world`), `fn[t][c]`, `cam_id[t][c]`, and `w`, `h`. K is used unchanged, with pixel
centres at +0.5, as the authors of the files use it for rendering. If the calibration meant integer centres, the error would
be at most half a pixel of its own resolution.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ....pipeline import CaptureError
from .. import checks
from ..arrays import load_array
from ..reading import TEST, TRAIN, Options, Reading, Shot
from ..rigs import all_fixed

_FILES = ((TRAIN, "train_meta.json"), (TEST, "test_meta.json"))
_POINTS = "init_pt_cld.npz"


def detect(root: Path) -> str | None:
    return "train_meta.json" if (root / "train_meta.json").is_file() else None


def read(root: Path, options: Options) -> Reading:
    shots: list[Shot] = []
    sizes: list[tuple[float, float]] = []
    sources = []
    for split, file in _FILES:
        if not (root / file).is_file():
            raise CaptureError(f"{file}: missing beside train_meta.json; copy it into {root}")
        data = checks.read_json(root, file)
        sources.append(file)
        sizes.append((checks.number(data.get("w"), f"{file}: w", 1, 1e6), checks.number(data.get("h"), f"{file}: h", 1, 1e6)))
        shots += _shots(root, file, data, split)
    shots.sort(key=lambda s: (s.camera, s.time))
    headers, alpha = checks.image_headers(root, [str(s.file) for s in shots])
    for shot, (width, height) in zip(shots, headers, strict=True):
        shot.size = width, height
        file_width, file_height = sizes[0 if shot.split == TRAIN else 1]
        if abs(width * file_height / (height * file_width) - 1) > 0.02:
            raise CaptureError(
                f"{_FILES[shot.split == TEST][1]}: w, h say {file_width:g}x{file_height:g}, {shot.file} is {width}x{height}; "
                "correct w and h or the images"
            )
        if shot.K is not None:
            shot.K = np.diag([width / file_width, height / file_height, 1.0]) @ shot.K
    points, colors = _points(root)
    return Reading(
        why="train_meta.json + test_meta.json",
        shots=shots,
        alpha=alpha,
        has_split=True,
        fixed_cameras=all_fixed(shots),
        sources=(*sources, *([_POINTS] if points is not None else [])),
        points=points,
        point_colors=colors,
    )


def _shots(root: Path, file: str, data: dict[str, Any], split: int) -> list[Shot]:
    table = {key: checks.items(data.get(key), f"{file}: {key}") for key in ("k", "w2c", "fn", "cam_id")}
    lengths = {key: len(value) for key, value in table.items()}
    if len(set(lengths.values())) != 1:
        raise CaptureError(f"{file}: k, w2c, fn and cam_id differ in their number of times ({lengths}); the file is damaged")
    shots = []
    for t in range(lengths["fn"]):
        row = {key: checks.items(value[t], f"{file}: {key}[{t}]") for key, value in table.items()}
        counts = {key: len(value) for key, value in row.items()}
        if len(set(counts.values())) != 1:
            raise CaptureError(f"{file}: time {t}: k, w2c, fn and cam_id differ in their number of cameras ({counts}); the file is damaged")
        for c in range(counts["fn"]):
            where = f"{file}: time {t}, camera {c}"
            name = checks.text(row["fn"][c], f"{where}: fn")
            image = checks.find_image(root, "ims/" + name, f"{where}: fn")
            K = checks.matrix(row["k"][c], f"{where}: k", ((3, 3),))
            w2c = checks.matrix(row["w2c"][c], f"{where}: w2c", ((4, 4), (3, 4)))
            mask = ("seg/" + name).rsplit(".", 1)[0] + ".png"
            shots.append(
                Shot(
                    name=image,
                    camera=checks.integer(row["cam_id"][c], f"{where}: cam_id", 0, 10**6),
                    time=float(t),
                    size=(0, 0),  # set by `read`, which reads all image headers together
                    split=split,
                    file=image,
                    mask=mask if (root / mask).is_file() else None,
                    K=checks.intrinsics(K[0, 0], K[1, 1], K[0, 2], K[1, 2], f"{where}: k", skew=K[0, 1]),
                    cam_from_world=checks.rigid(w2c, f"{where}: w2c"),
                )
            )
    return shots


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
