"""What is known of a capture before anything runs, as a typed object."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any, Self

from ..scene.training.curriculum import MIN_CAMERAS

_ONLY_WHERE_TRUE = ("upright", "untimed")  # absent from the JSON where they are not


@dataclass(frozen=True, kw_only=True)
class Facts:
    """From file names, JSON and image headers alone; no picture is decoded for it. docs/artifacts.md has the table.

    The pipeline hands facts around as plain JSON, since it knows nothing of captures; stages begin with `Facts.of`.
    """

    format: str = ""  # the reader: "dnerf", "n3v", ...
    why: str = ""  # why it was recognised, for people
    frames: int = 0
    cameras: int = 1  # distinct ones
    times: int = 1  # distinct ones
    width: int = 0  # px, one size for the capture
    height: int = 0
    poses: bool = False  # the files hold poses
    points: bool = False  # the files hold points
    alpha: bool = False  # pictures have an alpha channel
    static: bool = False  # --static, or only one time
    pairs: int = 0  # frames for which the same camera also saw the next time
    fixed_cameras: bool = False  # several synchronised cameras that do not move, as the files say
    splits: Mapping[str, int] = field(default_factory=dict)  # frames of "train", "val", "test"
    images_in_files: bool = True  # no extraction needed
    upright: bool = False  # images are turned as their EXIF data ask for
    untimed: bool = False  # the files give no times: frames are in the order of their names
    new_items: int | None = None  # in an estimate: how many of the stage's items are made; the others are taken over

    @classmethod
    def of(cls, facts: Mapping[str, Any]) -> Self:
        """From the mapping that the pipeline hands to stages. Raises TypeError where it has a name that is none of a fact."""
        return cls(**facts)

    @classmethod
    def among(cls, attrs: Mapping[str, Any]) -> Self:
        """From the attributes of a `frames` artifact, which holds other things beside."""
        known = {one.name for one in fields(cls)}
        return cls(**{name: value for name, value in attrs.items() if name in known})

    def as_json(self) -> dict[str, Any]:
        """Inverse of `of`."""
        values = {one.name: getattr(self, one.name) for one in fields(self)}
        left_out = [name for name in _ONLY_WHERE_TRUE if not values[name]] + (["new_items"] if self.new_items is None else [])
        return {name: value for name, value in values.items() if name not in left_out}

    @property
    def rig(self) -> bool:
        """Several cameras see each time."""
        return self.frames >= MIN_CAMERAS * self.times
