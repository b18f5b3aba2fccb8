"""How many pictures a film has, and how many of them a second."""

from __future__ import annotations

import math
from dataclasses import dataclass

from ...pipeline import SettingsError
from ...stages.exports.camera_path import USUAL_SECONDS
from .camera_path import MOST_FRAMES

FPS = 30.0
SLOWEST, FASTEST = 1.0, 240.0  # pictures per second
ANSWER = "leave one of them out"


@dataclass(frozen=True)
class Film:
    """count: of its pictures. fps: pictures per second. why: where its length comes from, for people."""

    count: int
    fps: float
    why: str

    @property
    def seconds(self) -> float:
        return self.count / self.fps


@dataclass(frozen=True)
class Asked:
    """--frames, --seconds and --fps as they were given; None if they were not. Raises SettingsError for what is no number."""

    frames: int | None
    seconds: float | None
    fps: float | None

    def __post_init__(self) -> None:
        for name, value in (("--seconds", self.seconds), ("--fps", self.fps)):
            if value is not None and not math.isfinite(value):
                raise SettingsError(f"{name} {value}: give a number")

    def film(self, natural: float | None) -> Film:
        """A film of a path by name that takes ``natural`` seconds in real time; None if nothing says how long it takes.

        Raises SettingsError if the options contradict one another or the film would be too long.
        """
        if self.frames is not None and self.seconds is not None:
            return self._of_count(self.frames)
        fps = self.fps or FPS
        if self.frames is not None:
            return Film(self.frames, fps, "--frames")
        if self.seconds is not None:
            count, why = max(1, round(self.seconds * fps)), "--seconds"
        elif natural is not None:
            count, why = round(natural * fps) + 1, "real time"  # the first picture at the first time, the last at the last
        else:
            count, why = round(USUAL_SECONDS * fps), "by default"
        if count > MOST_FRAMES:
            raise SettingsError(
                f"{count} pictures ({count / fps:.0f} s, {why}) are more than {MOST_FRAMES}; give --seconds, --fps or --frames"
            )
        return Film(count, fps, why)

    def film_of(self, count: int, fps: float | None) -> Film:
        """A film of a path file with ``count`` views that states ``fps``, or does not: None. Raises SettingsError as `film` does."""
        if self.frames is not None:
            raise SettingsError("--frames: a path file defines its number of views itself; leave --frames out")
        if self.seconds is not None:
            return self._of_count(count)
        if self.fps is not None:
            return Film(count, self.fps, "--fps")
        if fps is None:
            return Film(count, FPS, "by default")
        self._bounded(fps, f"the path file's rate of {fps:g} pictures a second")
        return Film(count, fps, "as its file says")

    def _of_count(self, count: int) -> Film:
        assert self.seconds is not None
        if self.fps is not None:
            if round(self.seconds * self.fps) != count:
                made = f"{self.seconds * self.fps:.6g}"
                raise SettingsError(f"--seconds {self.seconds:g} --fps {self.fps:g}: that makes {made} pictures, not {count}; {ANSWER}")
            return Film(count, self.fps, "--seconds")
        self._bounded(count / self.seconds, f"{count} pictures in --seconds {self.seconds:g}")
        return Film(count, count / self.seconds, "--seconds")

    def _bounded(self, fps: float, what: str) -> None:
        if not SLOWEST <= fps <= FASTEST:
            raise SettingsError(f"{what}: {fps:.4g} pictures a second, but {SLOWEST:g} to {FASTEST:g} are possible; give --fps")
