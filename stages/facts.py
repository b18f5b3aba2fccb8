"""Facts about a capture that are known before anything runs, as a typed object."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any, Self

from ..scene.training.curriculum import MIN_CAMERAS

STANDS_STILL = (
    "one camera that stands still: its pictures do not show how far away things are, which is assumed where no depth is given; "
    "views from beside the camera are guesses, and a few percent of the distance is as far as they hold"
)
_ONLY_WHERE_TRUE = ("upright", "untimed", "depths")  # left out of the JSON if false
_ONLY_WHERE_UNUSUAL = {"every_time": 1, "new_items": None}  # left out of the JSON if they have these values


@dataclass(frozen=True, kw_only=True)
class Facts:
    """Facts from file names, JSON and image headers alone; no picture is decoded. docs/artifacts.md lists them all.

    The pipeline knows nothing of captures and passes facts on as plain JSON, so stages convert them with `Facts.of` first.
    """

    format: str = ""  # the reader: "dnerf", "n3v", ...
    why: str = ""  # why this format was recognised, for people
    frames: int = 0
    cameras: int = 1  # number of distinct cameras
    times: int = 1  # number of distinct times
    width: int = 0  # px, the same for all frames
    height: int = 0
    poses: bool = False  # the files contain poses
    points: bool = False  # the files contain points
    alpha: bool = False  # pictures have transparent pixels
    static: bool = False  # --static, or only one time
    pairs: int = 0  # frames for which the same camera also saw the next time
    fixed_cameras: bool = False  # no camera moves, according to the files
    splits: Mapping[str, int] = field(default_factory=dict)  # number of "train", "val" and "test" frames
    images_in_files: bool = True  # pictures are image files; nothing is extracted from videos
    upright: bool = False  # images are rotated as their EXIF data ask
    untimed: bool = False  # the files give no times: frames are in the order of their names
    depths: int = 0  # frames with a depth map in the files
    every_time: int = 1  # every so many-th time trains, and the others are test; 1 unless frames.every_time is set
    new_items: int | None = None  # in an estimate: how many of the stage's items are computed; the others are reused

    @classmethod
    def of(cls, facts: Mapping[str, Any]) -> Self:
        """From the mapping that the pipeline passes to stages. Raises TypeError for a name that is not a fact."""
        return cls(**facts)

    @classmethod
    def among(cls, attrs: Mapping[str, Any]) -> Self:
        """From the attributes of a `frames` artifact, which has other attributes too."""
        known = {one.name for one in fields(cls)}
        return cls(**{name: value for name, value in attrs.items() if name in known})

    def as_json(self) -> dict[str, Any]:
        """Inverse of `of`."""
        values = {one.name: getattr(self, one.name) for one in fields(self)}
        left_out = [name for name in _ONLY_WHERE_TRUE if not values[name]]
        left_out += [name for name, usual in _ONLY_WHERE_UNUSUAL.items() if values[name] == usual]
        return {name: value for name, value in values.items() if name not in left_out}

    @property
    def rig(self) -> bool:
        """Whether several cameras see each time."""
        return self.frames >= MIN_CAMERAS * self.times

    @property
    def stands_still(self) -> bool:
        """Whether one camera took all frames from one place, according to the files."""
        return self.fixed_cameras and self.cameras == 1
