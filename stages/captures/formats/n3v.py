"""Plenoptic Video (N3V) and the like: `camNN.mp4` or `camNN/`, and a pose for each camera; fixed synchronised cameras.
Videos of other names are read where a COLMAP model has one image of each, named like it.

The first camera in the plain order of names, cam00, is the test view, except with `frames.holdout=0`.

Poses come from `poses_bounds.npy` (rows in the plain order of the cameras' names, see `posed/llff_rows.py`), or, as in the layout
"multipleview" of 4DGaussians (github.com/hustvl/4DGaussians, `multipleviewprogress.sh` and `scene/multipleview_dataset.py`), from a COLMAP
model with one image for each camera in `sparse_/`, or from `poses_bounds_multipleview.npy`.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from ....pipeline import CaptureError
from .. import checks
from ..lens import Lens
from ..listing.names import is_video
from ..ply_points import add_points
from ..posed.llff_rows import camera_of, rows_of, told_order
from ..posed.stated import states_layout
from ..reading import TEST, TRAIN, Options, Reading, Shot, Video
from ..video.rates import rig_told
from . import video
from .colmap_model import model_of_cameras

_POSES = "poses_bounds.npy"
_MULTIVIEW = "poses_bounds_multipleview.npy"
_CLOUD = "points3D_multipleview.ply"
_NAME = re.compile(r"cam(era)?[_-]?\d+", re.IGNORECASE)


def detect(root: Path) -> str | None:
    cameras = _cameras(root)[0]
    if not cameras:
        return None
    for file in (_POSES, _MULTIVIEW):
        if (root / file).is_file() and not (file == _MULTIVIEW and states_layout(root)):
            return f"{file} and {len(cameras)} cameras"
    model = None if states_layout(root) else model_of_cameras(root, cameras)
    return None if model is None else f"a COLMAP model of {len(cameras)} cameras in {model.where}"


def read(root: Path, options: Options) -> Reading:
    cameras, use_movies = _cameras(root)
    if not cameras:
        raise CaptureError(f"{root}: no camNN.mp4 and no camNN/ beside {_POSES}; rename the cameras or give another --format")
    if len(cameras) < 2:
        raise CaptureError(f"{root}: one camera ({cameras[0]}), and it is the test view; at least two are needed")
    rows = next((file for file in (_POSES, _MULTIVIEW) if (root / file).is_file()), None)
    model = model_of_cameras(root, cameras) if rows != _POSES else None
    if rows is None and model is None:
        raise CaptureError(f"{_POSES}: missing in {root}; the Plenoptic Video layout needs it beside camNN.mp4 or camNN/")
    unposed = [name for name in cameras if model is not None and name not in model.images]
    cameras = [name for name in cameras if name not in unposed]
    table = rows_of(root, rows, cameras, "cameras") if model is None and rows is not None else None
    test = cameras[0]  # cam00
    reading = _from_videos(root, cameras, options) if use_movies else _from_folders(root, cameras, options)
    first: dict[str, Shot] = {}
    for shot in reading.shots:
        first.setdefault(shot.camera, shot)
    lenses: dict[str, Lens] = {}
    poses: dict[str, np.ndarray] = {}
    for i, name in enumerate(cameras):
        picture = first[name].file or name
        if model is not None:
            lenses[name], poses[name] = model.camera(name, root, picture, first[name].size)
        elif table is not None:
            K, poses[name] = camera_of(table[i], f"{rows}: row {i} ({name})", root, picture, first[name].size)
            lenses[name] = Lens(K, np.zeros(4))
    for shot in reading.shots:
        shot.split = TEST if shot.camera == test and options.holdout else TRAIN
        shot.K, shot.distortion, shot.fisheye = lenses[shot.camera]
        shot.cam_from_world = poses[shot.camera]
    source = f"the COLMAP model in {model.where}" if model is not None else str(rows)
    kind, held = "videos" if use_movies else "folders", f"{test} is test" if options.holdout else "all train"
    reading.why = f"{len(cameras)} cameras as {kind} + {source}, {held}"
    reading.sources = model.files if model is not None else (str(rows),)
    reading.fixed_cameras = True
    reading.has_split = options.holdout > 0
    if reading.has_split:
        reading.notes += (f"{test} is held out for testing, as is the custom of this layout; --set frames.holdout=0 trains on it, too",)
    if unposed:
        reading.notes += (
            f"{len(unposed)} of {len(unposed) + len(cameras)} cameras have no pose in {source} and are left out: {', '.join(unposed)}",
        )
        reading.spoken_for += tuple(unposed)
    _add_rest(root, reading, rows, model is not None, cameras)
    return reading


def _add_rest(root: Path, reading: Reading, rows: str | None, modelled: bool, cameras: list[str]) -> None:
    """Points of the layout "multipleview", and notes about what is matched by order or not read."""
    if rows is not None and not modelled:
        reading.notes += told_order(rows, cameras)
        if rows == _MULTIVIEW and len(cameras) > 9:
            reading.notes += (
                f"rows of {rows} are matched to {cameras[0]}, {cameras[1]}, ... in this order, since no model in sparse_/ names them; "
                "a file whose rows are those of image1, image10, image2, ... needs that model",
            )
    if modelled and rows is not None:
        reading.notes += (f"{rows} is not read, because the COLMAP model has the poses and names the cameras",)
        reading.spoken_for += (rows,)
    if (root / _CLOUD).is_file() and (modelled or rows == _MULTIVIEW):
        add_points(reading, root, _CLOUD)


def _from_videos(root: Path, cameras: list[str], options: Options) -> Reading:
    headers = {name: video.survey(root, name) for name in cameras}
    _same_counts({name: len(h.seconds) for name, h in headers.items()}, "; --format videos aligns their clocks, without these poses")
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
    shots = [
        Shot(file, c, float(i), size, file=file, step=i if len(taken) < total else None)
        for (c, i, file), size in zip(taken_files, sizes, strict=True)
    ]
    first: dict[str, Shot] = {}
    for shot in shots:
        if shot.size != (one := first.setdefault(shot.camera, shot)).size:
            raise CaptureError(
                f"{shot.name}: {shot.size[0]}x{shot.size[1]}, but {one.name} of the same camera is {one.size[0]}x{one.size[1]}; "
                "one row of poses cannot serve both, bring them to one size"
            )
    return Reading("", shots, alpha=alpha, notes=(*_note(taken, total), *_other_names(files)))


def _other_names(files: dict[str, list[str]]) -> tuple[str, ...]:
    """A note for people if the frames of the cameras have other names, and so are matched by their order alone."""
    stems = {camera: [Path(file).stem for file in names] for camera, names in files.items()}
    first = next(iter(stems))
    other = next((camera for camera in stems if stems[camera] != stems[first]), None)
    if other is None:
        return ()
    pair = next((a, b) for a, b in zip(stems[first], stems[other], strict=True) if a != b)
    return (f"frames of {first} and {other} have different names ({pair[0]}, {pair[1]}), and are matched in the order of their numbers",)


def _note(taken: tuple[int, ...], total: int) -> tuple[str, ...]:
    return (f"took {len(taken)} of {total} times",) if len(taken) < total else ()


def _same_counts(counts: dict[str, int], also: str = "") -> None:
    if len(set(counts.values())) > 1:
        short = min(counts, key=lambda name: counts[name])
        raise CaptureError(
            f"{short}: {counts[short]} frames, other cameras have up to {max(counts.values())}; synchronised cameras need equal counts, "
            f"copy it again or trim the others{also}"
        )


def _cameras(root: Path) -> tuple[list[str], bool]:
    """The cameras in the plain order of their names (as the loaders of this layout sort), and whether they are videos."""
    listed = checks.list_folder(root) if root.is_dir() else []
    folders = [name for name in listed if _NAME.fullmatch(name) and (root / name).is_dir()]
    videos = [name for name in listed if is_video(name) and (root / name).is_file()]
    movies = [name for name in videos if _NAME.fullmatch(name.rsplit(".", 1)[0])]
    if not movies and not folders and len(videos) > 1 and model_of_cameras(root, videos) is not None:
        movies = videos  # whatever their names: the model has them
    use_movies = len(movies) > 0 and len(movies) >= len(folders)
    return sorted(movies if use_movies else folders), use_movies


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
