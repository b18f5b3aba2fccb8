"""Plenoptic Video (N3V): `camNN.mp4` or `camNN/` and `poses_bounds.npy`; fixed synchronised cameras, cam00 is the test view.

`poses_bounds.npy` has LLFF's format: [N,17], for each camera (sorted by name) a 3x5 matrix whose columns are the camera's
down, right and back axes in the world, its centre, and (h, w, focal); then near and far.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from ....pipeline import CaptureError
from .. import checks
from ..arrays import load_array
from ..capture import TEST, TRAIN, Options, Reading, Shot, Video
from ..video.rates import rig_told
from . import video

_POSES = "poses_bounds.npy"
_MOST_CAMERAS = 100_000
_NAME = re.compile(r"cam\d+")


def detect(root: Path) -> str | None:
    if not (root / _POSES).is_file():
        return None
    count = max(len(_videos(root)), len(_folders(root)))
    return f"{_POSES} and {count} cameras" if count else None


def read(root: Path, options: Options) -> Reading:
    if not (root / _POSES).is_file():
        raise CaptureError(f"{_POSES}: missing in {root}; the Plenoptic Video layout needs it beside camNN.mp4 or camNN/")
    movies, folders = _videos(root), _folders(root)
    if not movies and not folders:
        raise CaptureError(f"{root}: no camNN.mp4 and no camNN/ beside {_POSES}; rename the cameras or give another --format")
    use_movies = len(movies) >= len(folders)
    cameras = movies if use_movies else folders
    if len(cameras) < 2:
        raise CaptureError(f"{root}: one camera ({cameras[0]}), and it is the test view; at least two are needed")
    poses = _poses(root, cameras)
    test = cameras[0]  # cam00
    reading = _from_videos(root, cameras, options) if use_movies else _from_folders(root, cameras, options)
    sizes = {shot.camera: shot.size for shot in reading.shots}
    by_camera = {name: _camera(poses[i], f"{_POSES}: row {i} ({name})", sizes[name]) for i, name in enumerate(cameras)}
    for shot in reading.shots:
        shot.split = TEST if shot.camera == test else TRAIN
        shot.K, shot.cam_from_world = by_camera[shot.camera]
    reading.why = f"{len(cameras)} cameras {'as videos' if use_movies else 'as folders'} + {_POSES}, {test} is test"
    reading.sources = (_POSES,)
    reading.fixed_cameras = True
    reading.has_split = True
    return reading


def _from_videos(root: Path, cameras: list[str], options: Options) -> Reading:
    headers = {name: video.probe(root, name) for name in cameras}
    _same_counts({name: len(h.seconds) for name, h in headers.items()})
    first = headers[cameras[0]]
    sizes = {name: (header.width, header.height) for name, header in headers.items()}
    total = len(first.seconds)
    taken = video.choose(total, options, None)
    shots = [Shot(f"{name}#{i}", name, float(i), sizes[name], seconds=first.seconds[i]) for name in cameras for i in taken]
    movies = tuple(Video(name, n * len(taken), taken, total) for n, name in enumerate(cameras))
    return Reading("", shots, fps=first.fps, videos=movies, notes=(*_note(taken, total), *rig_told(headers)))


def _from_folders(root: Path, cameras: list[str], options: Options) -> Reading:
    files = {name: _frames_of(root, name) for name in cameras}
    _same_counts({name: len(f) for name, f in files.items()})
    total = len(files[cameras[0]])
    taken = video.choose(total, options, None)
    taken_files = [(c, i, files[c][i]) for c in cameras for i in taken]
    sizes, alpha = checks.image_headers(root, [file for _, _, file in taken_files])
    shots = [Shot(file, c, float(i), size, file=file) for (c, i, file), size in zip(taken_files, sizes, strict=True)]
    first: dict[str, Shot] = {}
    for shot in shots:
        if shot.size != (one := first.setdefault(shot.camera, shot)).size:
            raise CaptureError(
                f"{shot.name}: {shot.size[0]}x{shot.size[1]}, but {one.name} of the same camera is {one.size[0]}x{one.size[1]}; "
                "one row of poses cannot serve both, bring them to one size"
            )
    return Reading("", shots, alpha=alpha, notes=_note(taken, total))


def _note(taken: tuple[int, ...], total: int) -> tuple[str, ...]:
    return (f"took {len(taken)} of {total} times",) if len(taken) < total else ()


def _same_counts(counts: dict[str, int]) -> None:
    if len(set(counts.values())) > 1:
        short = min(counts, key=lambda name: counts[name])
        raise CaptureError(
            f"{short}: {counts[short]} frames, other cameras have up to {max(counts.values())}; synchronised cameras need equal counts, "
            "copy it again or trim the others"
        )


def _poses(root: Path, cameras: list[str]) -> np.ndarray:
    """[N,17] float64, one row per camera."""
    table = load_array(root, _POSES, (17,), most=_MOST_CAMERAS)
    if len(table) != len(cameras):
        raise CaptureError(
            f"{_POSES}: {len(table)} rows for {len(cameras)} cameras ({cameras[0]} .. {cameras[-1]}); add or remove cameras to match"
        )
    return table


def _camera(row: np.ndarray, where: str, size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """(K, cam_from_world) of one row. The focal length is scaled from the file's h, w to the size of the pictures."""
    if not (np.abs(row) < 1e12).all():
        raise CaptureError(f"{where}: holds NaN, Inf or impossibly large numbers; estimate the poses again")
    width, height = size
    matrix = row[:15].reshape(3, 5)
    down, right, back = matrix[:, 0], matrix[:, 1], matrix[:, 2]
    file_height, file_width, focal = matrix[:, 4]
    if min(file_height, file_width) < 1:
        raise CaptureError(f"{where}: image size {file_width:g}x{file_height:g} makes no sense; correct columns h and w")
    world_from_cam = np.column_stack([right, down, -back, matrix[:, 3]])
    cam_from_world = checks.inverse(checks.rigid(world_from_cam, where))
    sx, sy = width / file_width, height / file_height
    if abs(sx / sy - 1) > 0.02:
        raise CaptureError(
            f"{where}: made for {file_width:g}x{file_height:g}, but the pictures are {width}x{height}, "
            "which have another aspect ratio; correct h and w"
        )
    return checks.intrinsics(focal * sx, focal * sy, width / 2, height / 2, where), cam_from_world


def _videos(root: Path) -> list[str]:
    return [
        name
        for name in (checks.list_folder(root) if root.is_dir() else [])
        if _NAME.fullmatch(name.rsplit(".", 1)[0]) and name.lower().endswith(checks.VIDEO_SUFFIXES) and (root / name).is_file()
    ]


def _folders(root: Path) -> list[str]:
    return [name for name in (checks.list_folder(root) if root.is_dir() else []) if _NAME.fullmatch(name) and (root / name).is_dir()]


def _frames_of(root: Path, camera: str) -> list[str]:
    """Images of one camera, directly in its folder or in `camNN/images`."""
    for folder in (camera, f"{camera}/images"):
        if not (root / folder).is_dir():
            continue
        names = [n for n in checks.list_folder(root / folder) if n.lower().endswith(checks.IMAGE_SUFFIXES)]
        if names:
            for name in names:
                checks.resolve_inside(root, f"{folder}/{name}", f"{folder}/{name}")
                if not (root / folder / name).is_file():
                    raise CaptureError(f"{folder}/{name}: not a file but a folder, a pipe or a broken link; put the image there")
            return [f"{folder}/{name}" for name in names]
    raise CaptureError(f"{camera}: holds no images; add its frames or remove the camera (and its row in {_POSES})")
