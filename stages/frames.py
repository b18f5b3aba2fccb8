"""Stage `frames`: metadata of every frame (time, camera, split, pose), and the decoded pictures of videos.

Image files are checked by decoding each one once, and are not copied. Videos are decoded frame by frame into the artifact, so memory
stays bounded. docs/artifacts.md documents the arrays and attributes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

from pydantic import Field

from ..pipeline import Applies, Context, Given, Resources, Settings, Stage
from .captures import Capture, Format, recognise
from .captures.usual import USUAL
from .decoding.videos import video_parts
from .facts import Facts


class FramesSettings(Settings):
    """How the capture is read. All names but ``watermark`` match the arguments of `captures.recognise`."""

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
        None, ge=2, le=1_000_000, description="most frames of a camera; none: 200 of videos without poses, else all"
    )
    every: int | None = Field(
        None, ge=1, le=1_000_000, description="take every N-th frame of a video or image sequence; max_frames is then ignored"
    )
    every_time: int = Field(
        1, ge=1, le=1_000_000, description="train on every N-th time and test on the others, in place of holdout; 1 trains on all"
    )
    fps: float | None = Field(None, gt=0, le=1e6, description="frames per second of numbered images; 30 if the files do not say")
    sync: Literal["auto", "sound", "frames"] = Field(
        "auto",
        description="how the clocks of several videos are aligned; auto: by sound if that is clear for all of them, else by first frames",
    )
    watermark: bool = Field(True, description="ignore what stands still in the pictures of a camera that moves, such as a logo")


def recognise_for(path: str | Path, settings: FramesSettings, heard: Path | None = None, device: str | None = None) -> Capture:
    """`captures.recognise` with these settings. heard: folder that caches the sound envelopes of long videos. device: decides what is not
    set (`Capture.chosen`); None leaves all as it is. Raises `CaptureError`."""
    return recognise(path, **settings.model_dump(exclude={"watermark"}), heard=heard, usual=None if device is None else USUAL[device])


class Frames(Stage):
    name = "frames"
    items = "cameras"
    inputs = ()
    settings = FramesSettings
    reads_capture = True

    def applies(self, facts: Mapping[str, Any], settings: FramesSettings) -> Applies:
        known = Facts.of(facts)
        action = "pictures stay in their files" if known.images_in_files else "pictures are decoded from video"
        return Applies.yes(f"{known.frames} frames, {action}")

    def estimate(self, facts: Mapping[str, Any], settings: FramesSettings) -> float | None:
        """Decoding once on two cores: about 60 megapixels per second from image files, 15 from video into the store (measured)."""
        known = Facts.of(facts)
        new = (known.cameras if known.new_items is None else known.new_items) / known.cameras
        megapixels = new * known.frames * known.width * known.height / 1e6
        return 0.5 + megapixels / (60 if known.images_in_files else 15)

    def item_parts(self, given: Given) -> Sequence[Any]:
        """The videos, each of which is a camera; [] if the pictures are image files."""
        capture = _recognised(given)
        return video_parts(capture, given) if capture.images is None else []

    def resources(self, facts: Mapping[str, Any], settings: FramesSettings, device: str) -> Resources:
        from .estimates import picture_resources

        return picture_resources(Facts.of(facts), 0.3)

    def run(self, ctx: Context) -> None:
        from .decoding.capture import decode_capture

        decode_capture(_recognised(ctx), ctx)


def _recognised(given: Given | Context) -> Capture:
    return given.capture if isinstance(given.capture, Capture) else recognise_for(given.capture.root, given.settings)  # type: ignore[arg-type]
