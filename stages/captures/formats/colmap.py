"""A COLMAP model (`sparse/0` or `sparse`, text or binary) and `images/`: poses, points, and one camera over time or a rig in sub-folders.

Pixel centres lie at +0.5 in COLMAP's intrinsics, as in ours. Poses are `cam_from_world` in OpenCV axes: a quaternion w x y z and a
translation.
"""

from __future__ import annotations

import itertools
import mmap
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ....pipeline import CaptureError
from .. import checks
from ..arrays import MOST_POINTS
from ..keep_masks import add_masks
from ..lens import LARGEST_TERM, Lens, distortion_of
from ..reading import Options, Reading, Shot
from ..rigs import all_fixed, cameras_of, folders_of

_FOLDERS = ("sparse/0", "sparse")
# COLMAP's camera models in the order of their ids. For the supported models: whether fx and fy are one value, and how many distortion
# terms follow cx, cy. The terms are OpenCV's in OpenCV's order. Models with fisheye terms are listed separately.
_MODELS = (
    *("SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "OPENCV_FISHEYE", "FULL_OPENCV", "FOV", "SIMPLE_RADIAL_FISHEYE"),
    *("RADIAL_FISHEYE", "THIN_PRISM_FISHEYE", "RAD_TAN_THIN_PRISM_FISHEYE", "SIMPLE_DIVISION", "DIVISION", "SIMPLE_FISHEYE", "FISHEYE"),
)
_BROWN = {"SIMPLE_PINHOLE": (True, 0), "PINHOLE": (False, 0), "SIMPLE_RADIAL": (True, 1), "RADIAL": (True, 2), "OPENCV": (False, 4)}
_FISHEYE = {"SIMPLE_FISHEYE": (True, 0), "FISHEYE": (False, 0), "SIMPLE_RADIAL_FISHEYE": (True, 1), "RADIAL_FISHEYE": (True, 2)}
_LAYOUT = {**_BROWN, "FULL_OPENCV": (False, 8), **_FISHEYE, "OPENCV_FISHEYE": (False, 4)}


_MOST_IMAGES = 1_000_000
_LONGEST_LINE = 2**26  # characters; the line of an image's features lists about ten thousand of them
_LONGEST_NAME = 4096


@dataclass(frozen=True)
class _Image:
    name: str
    camera: int
    pose: np.ndarray  # qw qx qy qz tx ty tz


def detect(root: Path) -> str | None:
    model = _model(root)
    return f"a COLMAP model in {model[0]}" if model is not None and (root / "images").is_dir() else None


def read(root: Path, options: Options) -> Reading:
    model = _model(root)
    if model is None or not (root / "images").is_dir():
        raise CaptureError(f"{root}: no sparse/0 with cameras and images beside images/, which a COLMAP capture needs; pass its folder")
    folder, suffix = model
    files = {part: f"{folder}/{part}{suffix}" for part in ("cameras", "images", "points3D")}
    for file in files.values():
        checks.resolve_inside(root, file, file)
    has_points = (root / files["points3D"]).is_file()
    parse = _BINARY if suffix == ".bin" else _TEXT
    with _about(files["cameras"]):
        cameras = dict(parse[0](root / files["cameras"]))
    with _about(files["images"]):
        images = sorted(parse[1](root / files["images"]), key=lambda image: checks.natural_key(image.name))
    with _about(files["points3D"]):
        table = _table(parse[2](root / files["points3D"])) if has_points else np.zeros((0, 6))
    if not images:
        raise CaptureError(f"{files['images']}: no registered image; run structure from motion again")
    good = (np.abs(table) < 1e12).all(1)
    if not good.all():
        row = int(good.argmin())
        raise CaptureError(f"{files['points3D']}: point {row}: {table[row, :3].tolist()} is not a valid position; remove it")
    paths = [checks.find_image(root, f"images/{image.name}", f"{files['images']}: image {image.name!r}: name") for image in images]
    sizes, alpha = checks.image_headers(root, paths)
    rig = cameras_of(root, paths)
    places = rig.places or [("", i) for i in range(len(images))]
    shots = []
    for (camera, time), image, path, size in zip(places, images, paths, sizes, strict=True):
        if image.camera not in cameras:
            raise CaptureError(f"{files['images']}: image {image.name!r}: camera {image.camera} is not in {files['cameras']}; export again")
        lens = _lens(cameras[image.camera], f"{files['cameras']}: camera {image.camera}", *size)
        pose = _pose(image.pose, f"{files['images']}: image {image.name!r}: pose")
        shot = Shot(name=path, camera=checks.natural_key(camera), time=float(time), size=size, file=path, cam_from_world=pose)
        shot.K, shot.distortion, shot.fisheye = lens
        shots.append(shot)
    masked = add_masks(root, shots)
    present = sum(
        name.lower().endswith(checks.IMAGE_SUFFIXES)
        for place in {"images", *folders_of(paths)}
        for name in checks.list_folder(root / place)
    )
    notes = [*masked, *([rig.note] if rig.note else [])]
    if present > len(shots):
        notes.append(f"{present - len(shots)} images without a pose in {folder} are left out")
    layout = "a static scene" if options.static else f"{len({s.camera for s in shots})} cameras" if rig.places else "one camera over time"
    return Reading(
        why=f"a COLMAP model in {folder}, {layout}",
        shots=shots,
        alpha=alpha,
        sources=(*(file for part, file in files.items() if part != "points3D" or has_points), *rig.others),
        points=table[:, :3].copy() if len(table) else None,
        point_colors=np.clip(table[:, 3:], 0, 255).astype(np.uint8) if len(table) else None,
        fixed_cameras=all_fixed(shots),
        untimed=not rig.places,
        notes=tuple(notes),
    )


@contextmanager
def _about(file: str) -> Iterator[None]:
    """Turns any error inside the block into a CaptureError that names `file`."""
    try:
        yield
    except CaptureError as error:
        raise CaptureError(f"{file}: {error}") from error
    except (OSError, ValueError, IndexError, struct.error, OverflowError) as error:
        raise CaptureError(f"{file}: the COLMAP model cannot be read, perhaps cut short ({error}); export it again") from error


def _table(points: Iterator[list[float]]) -> np.ndarray:
    """The points as [P, 6] float64. Raises ValueError for more than `MOST_POINTS`."""
    values = np.fromiter((row for row in itertools.islice(points, MOST_POINTS + 1)), dtype=np.dtype((np.float64, 6)))
    if len(values) > MOST_POINTS:
        raise ValueError(f"more than {MOST_POINTS} points")
    return values


def _model(root: Path) -> tuple[str, str] | None:
    """(folder, suffix) of the model, preferring binary to text; None if there is none."""
    for folder in _FOLDERS:
        for suffix in (".bin", ".txt"):
            if all((root / folder / f"{part}{suffix}").is_file() for part in ("cameras", "images")):
                return folder, suffix
    return None


def _lens(camera: tuple[str, float, float, list[float]], where: str, width: int, height: int) -> Lens:
    model, file_width, file_height, values = camera
    if model not in _LAYOUT:
        raise CaptureError(f"{where}: {_refusal(model)}")
    one_focal, count = _LAYOUT[model]
    if len(values) != 4 - one_focal + count:
        raise CaptureError(f"{where}: {len(values)} parameters, but {model} has {4 - one_focal + count}; export the model again")
    numbers = [checks.number(value, f"{where}: parameter {i}") for i, value in enumerate(values)]
    fx, fy, cx, cy, *terms = numbers[:1] * one_focal + numbers
    for i, term in enumerate(terms, len(values) - count):
        checks.number(term, f"{where}: parameter {i}", -LARGEST_TERM, LARGEST_TERM)
    checks.number(file_width, f"{where}: width", 1, 1e6)
    checks.number(file_height, f"{where}: height", 1, 1e6)
    sx, sy = width / file_width, height / file_height
    if abs(sx / sy - 1) > 0.02:
        raise CaptureError(
            f"{where}: made for {file_width:g}x{file_height:g}, but the images are {width}x{height}, "
            "which have another aspect ratio; resize them"
        )
    fisheye = model.endswith("FISHEYE")
    return Lens(checks.intrinsics(fx * sx, fy * sy, cx * sx, cy * sy, where), distortion_of(terms), fisheye)


def _refusal(model: str) -> str:
    return f"model {model[:40]} is not supported ({', '.join(_LAYOUT)} are); undistort the images with colmap image_undistorter first"


def _pose(values: np.ndarray, where: str) -> np.ndarray:
    q = values[:4]
    norm = float(np.linalg.norm(q))
    if not np.isfinite(values).all() or norm < 1e-6:
        raise CaptureError(f"{where}: holds NaN, Inf or a zero quaternion; remove the image or estimate its pose again")
    w, x, y, z = q / norm
    matrix = np.eye(4)
    matrix[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    matrix[:3, 3] = values[4:7]
    return checks.rigid(matrix, where)


def _lines(path: Path) -> Iterator[str]:
    with path.open(encoding="utf-8") as file:
        while line := file.readline(_LONGEST_LINE):
            if len(line) == _LONGEST_LINE:
                raise ValueError(f"a line of more than {_LONGEST_LINE} characters")
            if not line.startswith("#"):
                yield line


def _text_cameras(path: Path) -> Iterator[tuple[int, tuple[str, float, float, list[float]]]]:
    for line in _lines(path):
        if line.strip():
            number, model, width, height, *values = line.split()
            yield int(number), (model, float(width), float(height), [float(v) for v in values])


def _text_images(path: Path) -> Iterator[_Image]:
    empty = False
    for line in itertools.islice(_lines(path), 0, None, 2):  # every second line lists the image's keypoints and may be empty
        if not line.strip():  # at the end of the file
            empty = True
            continue
        if empty:
            raise ValueError("an empty line where an image should be")
        parts = line.split(maxsplit=9)
        yield _Image(parts[9].strip(), int(parts[8]), np.array(parts[1:8], dtype=np.float64))


def _text_points(path: Path) -> Iterator[list[float]]:
    for line in _lines(path):
        if line.strip():
            yield [float(v) for v in line.split(maxsplit=7)[1:7]]


class _Bytes:
    """Reads little-endian records. Running past the end raises `struct.error`. The file is memory-mapped, since the images file also
    contains every feature and may be larger than the memory."""

    def __init__(self, path: Path) -> None:
        with path.open("rb") as file:
            self.data = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)  # ValueError for an empty file
        self.at = 0

    def count(self, what: str, most: int, least: int) -> int:
        """Reads the number of records that follow, each of at least ``least`` bytes."""
        count = int(self.take("Q")[0])
        if count > most:
            raise ValueError(f"{count} {what}, which are more than a capture has")
        if count * least > len(self.data) - self.at:
            raise ValueError(f"{count} {what} in {len(self.data)} bytes")
        return count

    def take(self, layout: str) -> tuple:
        values = struct.unpack_from("<" + layout, self.data, self.at)
        self.at += struct.calcsize("<" + layout)
        return values

    def skip(self, count: int) -> None:
        self.at += count
        if self.at > len(self.data):
            raise struct.error(f"ends after {len(self.data)} bytes")

    def name(self) -> str:
        end = self.data.find(b"\0", self.at, self.at + _LONGEST_NAME)
        if end < 0:
            raise ValueError(f"a name without an end at byte {self.at}")
        text = self.data[self.at : end].decode("utf-8")
        self.at = end + 1
        return text


def _binary_cameras(path: Path) -> Iterator[tuple[int, tuple[str, float, float, list[float]]]]:
    source = _Bytes(path)
    for _ in range(source.count("cameras", _MOST_IMAGES, 48)):
        number, kind, width, height = source.take("iiQQ")
        model = _MODELS[kind] if 0 <= kind < len(_MODELS) else f"number {kind}"
        if model not in _LAYOUT:  # the length of its record is unknown, so it cannot be skipped
            raise CaptureError(f"camera {number}: {_refusal(model)}")
        one_focal, count = _LAYOUT[model]
        yield number, (model, float(width), float(height), list(source.take(f"{4 - one_focal + count}d")))


def _binary_images(path: Path) -> Iterator[_Image]:
    source = _Bytes(path)
    for _ in range(source.count("images", _MOST_IMAGES, 73)):
        _, *pose, camera = source.take("i7di")
        name = source.name()
        source.skip(24 * source.take("Q")[0])
        yield _Image(name, camera, np.array(pose))


def _binary_points(path: Path) -> Iterator[list[float]]:
    source = _Bytes(path)
    for _ in range(source.count("points", MOST_POINTS, 51)):
        _, *values = source.take("Q3d3Bd")
        source.skip(8 * source.take("Q")[0])
        yield [float(v) for v in values[:6]]


_BINARY = (_binary_cameras, _binary_images, _binary_points)
_TEXT = (_text_cameras, _text_images, _text_points)
