"""The settings of `frames`: how a capture is read."""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar, Literal

from pydantic import Field

from ...pipeline import Settings
from ..captures import Capture, Format, recognise
from ..captures.usual import USUAL


class FramesSettings(Settings):
    """How the capture is read. All names but ``watermark`` match the arguments of `captures.recognise`."""

    respelled: ClassVar = {"sync": {"auto": None}}

    format: Format | None = Field(None, description="format of the capture; recognised from the files if it is not given")
    static: bool = Field(False, description="nothing moves: all frames count as one time, without flow and deformation")
    holdout: int = Field(8, ge=0, le=100_000, description="every N-th frame is a test frame if the files define no split; 0: none")
    background: Literal["white", "black"] | None = Field(None, description="colour behind pictures with alpha; white if there is alpha")
    max_size: int | None = Field(
        None,
        ge=16,
        le=65_536,
        description="px; pictures whose longer side exceeds this are scaled down, and their intrinsics with them; none: 960 on a CPU, 1600 "
        "on a GPU",
    )
    max_frames: int | None = Field(
        None, ge=2, le=1_000_000, description="most frames of a camera; none: 600 of one video, 200 of several or static ones, else all"
    )
    every: int | None = Field(
        None, ge=1, le=1_000_000, description="take every N-th frame of a video or image sequence; max_frames is then ignored"
    )
    every_time: int = Field(
        1, ge=1, le=1_000_000, description="train on every N-th time and test on the others, in place of holdout; 1 trains on all"
    )
    fps: float | None = Field(None, gt=0, le=1e6, description="frames per second of numbered images; 30 if the files do not say")
    sync: Literal["sound", "timecode", "frames"] | None = Field(
        None,
        description="how the clocks of several videos are aligned; none: by sound if that is clear for all, else by timecodes if all have "
        "one, else by first frames",
    )
    watermark: bool = Field(True, description="ignore what stands still in the pictures of a camera that moves, such as a logo")


def recognise_for(path: str | Path, settings: FramesSettings, audio_cache: Path | None = None, device: str | None = None) -> Capture:
    """`captures.recognise` with these settings. audio_cache: folder for the sound envelopes of long videos. device: decides what is not
    set (`Capture.chosen`); None leaves all as it is. Raises `CaptureError`."""
    usual = None if device is None else USUAL[device]
    return recognise(path, **settings.model_dump(exclude={"watermark"}), audio_cache=audio_cache, usual=usual)
