"""The `frames` artifact: metadata of every frame, and the decoded pictures of videos."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from ...pipeline import Artifact, ArtifactWriter
from ..facts import Facts

if TYPE_CHECKING:
    import zarr

_IMAGES = "images"
REQUIRED = ("camera", "time", "seconds", "split", "next")
ARRAYS = {  # name: unit, what it is, for readers of the file
    "camera": ("", "index of the camera that took the frame"),
    "time": ("", "time over the capture, in [0,1]"),
    "seconds": ("s", "time since the capture's start"),
    "split": ("", "0 train, 1 val, 2 test"),
    "next": ("", "the same camera's train frame at its next time, -1 where none"),
    "K": ("px", "intrinsics of the undistorted pictures, pixel centres at +0.5"),
    "cam_from_world": ("world", "OpenCV pose of the camera"),
    "distortion": ("", "k1 k2 p1 p2 [k3 k4 k5 k6], of fisheye lenses k1 k2 k3 k4"),
    "lens_K": ("px", "intrinsics of the pictures as the lens made them"),
    "fisheye": ("", "1: the lens is OpenCV's fisheye model"),
    "crop": ("px", "left, top, width, height of the part of each stored picture that is shown"),
    "watermark": ("", "255: stands still in all pictures, such as a logo, and is ignored"),
    "points": ("world", "points of the capture's files"),
    "point_colors": ("", "RGB of points"),
}
LISTS = ("files", "mask_files", "keep_files", "keep_turns", "turns", "depth_files", "depth_confidence_files", "origin", "K_hint")
OF_CAPTURE = ("watermark", "points", "point_colors", "origin", "K_hint", "next")  # the others of these have one row a frame


@dataclass(frozen=True)
class DecodedPictures:
    """Pictures of videos by frame index, uint8 [H, W, 3] RGB, not undistorted. Any thread may read."""

    artifact: Artifact
    chosen: np.ndarray | None = None  # numbers of the frames that count, in their order; None: all

    def __getitem__(self, i: int) -> np.ndarray:
        return np.asarray(self._array[self._number(i)])

    def digest(self, i: int) -> str:
        """Digest of the stored picture of frame i, which is one chunk. The picture itself is not read."""
        return self.artifact.manifest["files"][f"{_IMAGES}/c/{self._number(i)}/0/0/0"][1]

    def _number(self, i: int) -> int:
        return i if self.chosen is None else int(self.chosen[i])

    @cached_property
    def _array(self) -> zarr.Array:
        return self.artifact.array(_IMAGES)


@dataclass(frozen=True, kw_only=True)
class StoredFrames:
    """F frames in the order that all stages use, and P points. Fields that the capture lacks are None."""

    facts: Facts
    names: Sequence[str]  # [F], for people
    background: str | None  # "white" | "black": what alpha is composited on
    camera: np.ndarray  # [F] int32, index of the camera that took the frame
    time: np.ndarray  # [F] float64 in [0, 1] over the capture
    seconds: np.ndarray  # [F] float64, since the start of the capture
    split: np.ndarray  # [F] uint8: 0 train, 1 val, 2 test
    next: np.ndarray  # [F] int32, the same camera's training frame at its next time, -1 if none
    K: np.ndarray | None = None  # [F, 3, 3] float64 px, of the undistorted pictures
    cam_from_world: np.ndarray | None = None  # [F, 4, 4] float64, OpenCV; present if K is
    distortion: np.ndarray | None = None  # [F, 4 or 8] float64, OpenCV's terms; present if K is
    lens_K: np.ndarray | None = None  # [F, 3, 3] float64 px, of the distorted pictures; None if equal to K
    fisheye: np.ndarray | None = None  # [F] uint8, 1: OpenCV's fisheye model; None if no lens is a fisheye
    crop: np.ndarray | None = (
        None  # [F, 4] int32 px: left, top, width, height of the part shown of each as turned; None if all have one size
    )
    watermark: np.ndarray | None = None  # [H, W] uint8, 255: a watermark of all pictures, which are distorted here; None if there is none
    points: np.ndarray | None = None  # [P, 3] float64, world units
    point_colors: np.ndarray | None = None  # [P, 3] uint8; present if points are
    files: Sequence[str] | None = None  # [F], relative to the capture; None if pictures are decoded from videos
    mask_files: Sequence[str | None] | None = None  # [F]: white marks moving pixels
    keep_files: Sequence[str | None] | None = None  # [F]: black marks pixels to ignore
    keep_turns: Sequence[int] | None = None  # [F] EXIF orientations by which keep_files are rotated; present if those are
    turns: Sequence[int] | None = None  # [F] EXIF orientations by which pictures are turned once they are read; None if none is
    depth_files: Sequence[str | None] | None = None  # [F]: depth maps of any unit
    depth_confidence_files: Sequence[str | None] | None = None  # [F]: confidence in these, larger is surer
    origin: Sequence[float] | None = None  # 3 numbers: the point of the files' world that is the origin here; None if nothing was moved
    K_hint: Sequence[float] | None = None  # 9 numbers of an initial intrinsic matrix, px, row by row
    images: DecodedPictures | None = None  # for reading only; `create_images` makes them

    registered = None  # every pose in the files counts

    def write(self, out: ArtifactWriter, notes: Sequence[str]) -> None:
        """notes: remarks of the capture reader, for people."""
        for name, (unit, doc) in ARRAYS.items():
            if (values := getattr(self, name)) is not None:
                out.write(name, values, unit=unit, doc=doc)
        out.attrs.update(self.facts.as_json(), names=list(self.names), background=self.background)
        lists = {name: getattr(self, name) for name in LISTS}
        out.attrs.update({name: list(values) for name, values in lists.items() if values is not None})
        out.info["notes"] = list(notes)

    def only(self, chosen: np.ndarray) -> StoredFrames:
        """The frames ``chosen`` [n], which have no `next`. What is about the whole capture stays, `facts` too."""
        changed: dict[str, Any] = {"next": np.full(len(chosen), -1, np.int32)}
        for name in {"names", *ARRAYS, *LISTS} - set(OF_CAPTURE):
            values = getattr(self, name)
            if values is not None:
                changed[name] = values[chosen] if isinstance(values, np.ndarray) else [values[int(i)] for i in chosen]
        return replace(self, **changed, images=None if self.images is None else replace(self.images, chosen=chosen))

    @classmethod
    def read(cls, artifact: Artifact) -> StoredFrames:
        attrs, read = artifact.attrs, artifact.read
        listed: dict[str, Any] = {name: read(name) for name in ARRAYS if name in artifact or name in REQUIRED}
        listed |= {name: attrs.get(name) for name in LISTS}
        return cls(
            facts=Facts.among(attrs),
            names=attrs["names"],
            background=attrs["background"],
            images=DecodedPictures(artifact) if _IMAGES in artifact else None,
            **listed,
        )


def create_images(out: ArtifactWriter, frames: int, height: int, width: int) -> zarr.Array:
    """The array behind `StoredFrames.images`, [F, H, W, 3] uint8, to be filled one frame at a time."""
    return out.create(_IMAGES, (frames, height, width, 3), "uint8", (1, height, width, 3), doc="decoded RGB frames")


def write_videos(out: ArtifactWriter, spans: Sequence[tuple[int, int]]) -> None:
    """The first frame and the number of frames of each video, for `pictures_of_video`."""
    out.info["videos"] = [list(span) for span in spans]


def pictures_of_video(artifact: Artifact, number: int) -> Iterator[np.ndarray]:
    """The decoded pictures of video ``number``, uint8 [H, W, 3]. Raises ArtifactError if one cannot be read."""
    start, count = artifact.info["videos"][number]
    for i in range(start, start + count):
        yield artifact.read(_IMAGES, i)
