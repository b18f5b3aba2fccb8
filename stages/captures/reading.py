"""What a reader of captures is given and what it finds: `Options` in, a `Reading` of `Shot`s and `Video`s out."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from .usual import Usual

TRAIN, VAL, TEST = 0, 1, 2
SPLITS = ("train", "val", "test")
DEFAULT_FPS = 30.0  # for numbered images, and for cameras whose files give no frame rate


@dataclass(frozen=True)
class Options:
    """How a capture is to be read: the settings of the `frames` stage, and `audio_cache`, a folder for sounds (`sound/cache.py`)."""

    format: str | None = None
    static: bool = False
    holdout: int = 8
    background: str | None = None
    max_size: int | None = None
    max_frames: int | None = None
    every: int | None = None
    every_time: int = 1
    fps: float | None = None
    sync: str | None = None
    audio_cache: Path | None = None
    usual: Usual | None = None  # limits the size where max_size is None; None: no limit

    @property
    def size_limit(self) -> int | None:
        return self.max_size or (self.usual.size if self.usual else None)


@dataclass
class Shot:
    """One frame as a reader found it. `camera` is any sortable id; `time` is in the file's own unit; `size` is the width and height in px
    of the picture to which K applies."""

    name: str
    camera: Any
    time: float
    size: tuple[int, int]
    split: int = TRAIN
    file: str | None = None
    mask: str | None = None  # file; white marks moving pixels
    keep: str | None = None  # file; black marks pixels to ignore
    keep_turn: int = 1  # EXIF orientation by which `keep` is rotated, like its photo
    depth: str | None = None  # file, see `listing/depth_maps.py`
    depth_confidence: str | None = None  # file, of any unit: larger is surer
    seconds: float | None = None
    step: int | None = None  # its place on the clock of a sequence of which pictures are missing or not taken
    linked: bool = True  # whether it may form a pair with the same camera's next frame
    K: np.ndarray | None = None
    cam_from_world: np.ndarray | None = None
    distortion: np.ndarray | None = None
    fisheye: bool = False


@dataclass(frozen=True)
class Video:
    """A video file of the capture, and which of its frames are taken. In the capture these are consecutive, starting at `start`."""

    file: str
    start: int
    taken: tuple[int, ...]
    total: int


@dataclass
class Reading:
    """The result of a reader, from which `assemble` makes a `Capture`."""

    why: str
    shots: list[Shot]
    alpha: bool = False
    has_split: bool = False
    fps: float | None = None
    fixed_cameras: bool = False
    videos: tuple[Video, ...] = ()
    sources: tuple[str, ...] = ()  # further files, besides images and videos, that the result depends on
    points: np.ndarray | None = None
    point_colors: np.ndarray | None = None
    K_hint: np.ndarray | None = None
    notes: tuple[str, ...] = ()
    depth_notes: tuple[str, ...] = ()  # said if no shot has depth
    spoken_for: tuple[str, ...] = ()  # files and folders, relative to the capture, that are not read and that the notes already name
    upright: bool = False  # pictures are rotated as their EXIF data ask
    untimed: bool = False  # the files give no times: frames are in the order of their names
