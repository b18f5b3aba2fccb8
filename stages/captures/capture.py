"""`Capture`: the frames of a recording, known from names, JSON and image headers alone."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from .reading import Options, Video


@dataclass(frozen=True)
class Capture:
    """A recognised capture. F frames in a fixed order that every stage uses.

    `files` are the paths, relative to `root`, whose content determines the result (the digest of the capture); `facts` is the
    mapping of docs/artifacts.md. Arrays are those of the `frames` artifact, at its output size (after `max_size`); K applies to the
    distorted pictures (`captures/lens.py` explains distortion and fisheye). crop [F,4]: left, top, width and height, px, of the part of
    each picture, once it is turned, that is scaled to the output size; None if all are used whole. turns: the EXIF orientation (1, 6, 8) by
    which each picture and what belongs to it are turned after they are read; None if none is. origin [3]: the point of the files' world
    that is the origin here, None if nothing was moved. keep_turns: the EXIF orientation by which each mask of
    `keeps` is rotated; 1 if it already has the orientation of its picture as shown.
    """

    root: Path
    name: str
    files: tuple[str, ...]
    facts: Mapping[str, Any]
    options: Options
    names: tuple[str, ...]
    images: tuple[str, ...] | None
    masks: tuple[str | None, ...] | None
    keeps: tuple[str | None, ...] | None
    keep_turns: tuple[int, ...] | None
    depths: tuple[str | None, ...] | None
    depth_confidences: tuple[str | None, ...] | None
    videos: tuple[Video, ...]
    camera: np.ndarray
    time: np.ndarray
    seconds: np.ndarray
    split: np.ndarray
    next: np.ndarray
    K: np.ndarray | None
    cam_from_world: np.ndarray | None
    distortion: np.ndarray | None
    fisheye: np.ndarray | None
    crop: np.ndarray | None
    turns: tuple[int, ...] | None
    background: str | None
    points: np.ndarray | None = None
    point_colors: np.ndarray | None = None
    origin: np.ndarray | None = None
    K_hint: tuple[float, ...] | None = None
    notes: tuple[str, ...] = ()
    chosen: Mapping[str, int] = field(default_factory=dict)  # settings of `frames` that were not given, and that `options.usual` decided
