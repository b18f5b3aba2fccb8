"""A COLMAP model with one image for each camera of a rig: which image is which camera's."""

from __future__ import annotations

import posixpath
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .....pipeline import CaptureError
from ... import checks
from ...lens import Lens
from .lenses import lens_of
from .places import Model, model_places
from .records import ImageRecord


@dataclass(frozen=True)
class CameraModel:
    """where: the model's folder. files: what was read. images: of each camera, by the camera's name in the capture."""

    where: str
    files: tuple[str, ...]
    model: Model
    images: dict[str, ImageRecord]

    def camera(self, name: str, root: Path, picture: str, size: tuple[int, int]) -> tuple[Lens, np.ndarray]:
        """(lens, cam_from_world) for pictures of ``size``."""
        image, file = self.images[name], self.model.place.file("images")
        if image.camera not in self.model.cameras:
            raise CaptureError(f"{file}: image {image.name!r}: camera {image.camera} is not in the model; export it again")
        lens_where = f"{self.model.place.file('cameras')}: camera {image.camera}"
        lens = lens_of(self.model.cameras[image.camera], lens_where, root, picture, size)
        return lens, image.cam_from_world(f"{file}: image {image.name!r}: pose")


def model_of_cameras(root: Path, cameras: Sequence[str]) -> CameraModel | None:
    """The first model of a capture whose images are one of each of ``cameras`` (`cam01` or `cam01.mp4`), or of at least half of them. Their
    names tell: `cam01.jpg`, `cam01/frame_00001.jpg`, or `image1.jpg` as 4DGaussians has it. None if there is none, or if it is damaged."""
    for place in model_places(root):
        model = Model(place)
        try:
            images = model.images
        except CaptureError:
            continue
        found = _matched(images, cameras)
        if found is not None:
            files = tuple(place.file(part) for part in ("cameras", "images"))
            return CameraModel(place.folder or "the folder", files, model, found)
    return None


def _matched(images: Sequence[ImageRecord], cameras: Sequence[str]) -> dict[str, ImageRecord] | None:
    if not len(cameras) <= 2 * len(images) <= 2 * len(cameras):
        return None
    stems = {posixpath.splitext(name)[0] if name.lower().endswith(checks.VIDEO_SUFFIXES) else name: name for name in cameras}
    numbers = {_number(stem): name for stem, name in stems.items()}
    found: dict[str, ImageRecord] = {}
    for image in images:
        path = image.name.replace("\\", "/")
        folder, stem = path.split("/")[0], posixpath.splitext(posixpath.basename(path))[0]
        name = stems.get(folder) or stems.get(stem)
        if name is None and re.fullmatch(r"image\d+", stem) and len(numbers) == len(cameras):
            name = numbers.get(_number(stem))
        if name is None or name in found:
            return None
        found[name] = image
    return found


def _number(text: str) -> int:
    digits = re.findall(r"\d+", text)
    return int(digits[-1]) if digits and len(digits[-1]) < 10 else -1
