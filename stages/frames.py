"""Stage `frames`: what every frame is (time, camera, split, pose), and the decoded pictures of videos.

Pictures that already are files are checked by decoding each once and are not copied; videos are decoded frame by frame into the
artifact, so memory stays bounded. Arrays and attrs: docs/artifacts.md.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from pathlib import Path
from threading import Lock
from typing import TYPE_CHECKING, Any, Literal

from pydantic import Field

from ..pipeline import Applies, CaptureError, Context, Given, Resources, Settings, Stage, thread_count

if TYPE_CHECKING:
    import numpy as np

    from .captures import Capture

_DECODE_THREADS = 4  # at most
_LARGE = 40_000_000  # px of pictures that are decoded one at a time: such a one takes half a gigabyte, the largest 2 GB


class FramesSettings(Settings):
    """How the capture is read; the same names as the arguments of `captures.recognise`."""

    format: Literal["dnerf", "n3v", "panoptic", "nerfstudio", "nerfies", "colmap", "images", "video", "videos"] | None = Field(
        None, description="reader to use; recognised from the files when not set"
    )
    static: bool = Field(False, description="nothing moves: all times are one, no flow, no deformation")
    holdout: int = Field(8, ge=0, le=100_000, description="every N-th frame is test where the files carry no split; 0 for none")
    background: Literal["white", "black"] | None = Field(None, description="what alpha is composited on; white for captures with alpha")
    max_size: int | None = Field(None, ge=16, le=65_536, description="px; larger pictures are scaled down by area, intrinsics along")
    max_frames: int | None = Field(None, ge=2, le=1_000_000, description="at most so many frames of a camera (videos without poses: 200)")
    every: int | None = Field(
        None, ge=1, le=1_000_000, description="take every N-th frame of a video or image sequence; wins over max_frames"
    )
    fps: float | None = Field(None, gt=0, le=1e6, description="frames per second of numbered images; 30 where the files say nothing")
    sync: Literal["auto", "sound", "frames"] = Field(
        "auto",
        description="what aligns several videos' clocks; auto: their sound where all have some that tells, else their first frames",
    )


def recognise_for(path: str | Path, settings: FramesSettings, heard: Path | None = None) -> Capture:
    """`captures.recognise` with these settings; heard: a folder in which what was heard of long videos is kept. Raises `CaptureError`."""
    from .captures import recognise

    return recognise(path, **settings.model_dump(), heard=heard)


class Frames(Stage):
    name = "frames"
    items = "cameras"
    inputs = ()
    settings = FramesSettings
    reads_capture = True

    def applies(self, facts: Mapping[str, Any], settings: FramesSettings) -> Applies:
        action = "pictures stay in their files" if facts["images_in_files"] else "pictures are decoded from video"
        return Applies.yes(f"{facts['frames']} frames, {action}")

    def estimate(self, facts: Mapping[str, Any], settings: FramesSettings) -> float | None:
        """Decoding once, two cores: about 60 megapixels a second from image files, 15 from video into the store (measured)."""
        new = facts.get("new_items", facts["cameras"]) / facts["cameras"]
        megapixels = new * facts["frames"] * facts["width"] * facts["height"] / 1e6
        return 0.5 + megapixels / (60 if facts["images_in_files"] else 15)

    def item_parts(self, given: Given) -> Sequence[Any]:
        """The videos, each of which is a camera; [] where pictures stay in their files."""
        from .frames_videos import video_parts

        capture = _recognised(given)
        return video_parts(capture, given) if capture.images is None else []

    def resources(self, facts: Mapping[str, Any], settings: FramesSettings, device: str) -> Resources:
        from .estimates import picture_resources

        return picture_resources(facts, 0.3)

    def run(self, ctx: Context) -> None:
        from .frames_videos import decode_videos

        capture = _recognised(ctx)
        for note in capture.notes:
            ctx.log(note)
        if capture.images is None:
            decode_videos(capture, ctx)
        else:
            _check(capture, ctx)
        _write(capture, ctx)


def _recognised(given: Given | Context) -> Capture:
    from .captures import Capture

    return given.capture if isinstance(given.capture, Capture) else recognise_for(given.capture.root, given.settings)  # type: ignore[arg-type]


def _write(capture: Capture, ctx: Context) -> None:
    out = ctx.out
    out.write("camera", capture.camera, doc="index of the camera that took the frame")
    out.write("time", capture.time, doc="time over the capture, in [0,1]")
    out.write("seconds", capture.seconds, unit="s", doc="time since the capture's start")
    out.write("split", capture.split, doc="0 train, 1 val, 2 test")
    out.write("next", capture.next, doc="the same camera's train frame at its next time, -1 where none")
    if capture.K is not None and capture.cam_from_world is not None and capture.distortion is not None:
        K = _pinholes(capture, capture.K, capture.distortion, ctx)
        out.write("K", K, unit="px", doc="intrinsics of the undistorted pictures, pixel centres at +0.5")
        out.write("cam_from_world", capture.cam_from_world, unit="world", doc="OpenCV pose of the camera")
        out.write("distortion", capture.distortion, doc="k1 k2 p1 p2 [k3 k4 k5 k6], of fisheye lenses k1 k2 k3 k4")
        if (K != capture.K).any():
            out.write("lens_K", capture.K, unit="px", doc="intrinsics of the pictures as the lens made them")
        if capture.fisheye is not None:
            out.write("fisheye", capture.fisheye, doc="1: the lens is OpenCV's fisheye model")
    if capture.crop is not None:
        out.write("crop", capture.crop, unit="px", doc="left, top, width, height of the part of each stored picture that is shown")
    if capture.points is not None and capture.point_colors is not None:
        out.write("points", capture.points, unit="world", doc="points of the capture's files")
        out.write("point_colors", capture.point_colors, doc="RGB of points")
    out.attrs.update(capture.facts)
    out.attrs["names"] = list(capture.names)
    out.attrs["background"] = capture.background
    out.info["notes"] = list(capture.notes)
    if capture.images is not None:
        out.attrs["files"] = list(capture.images)
    if capture.masks is not None:
        out.attrs["mask_files"] = list(capture.masks)
    if capture.keeps is not None:
        out.attrs["keep_files"] = list(capture.keeps)
        out.attrs["keep_turns"] = list(capture.keep_turns or ())
    if capture.K_hint is not None:
        out.attrs["K_hint"] = list(capture.K_hint)


def _pinholes(capture: Capture, K: np.ndarray, distortion: np.ndarray, ctx: Context) -> np.ndarray:
    """K of the pinhole cameras to which the pictures are undistorted; says what of them is lost."""
    import numpy as np

    from ..vision.images.lenses import pinholes

    result, kept = pinholes(K, distortion, capture.fisheye, capture.facts["width"], capture.facts["height"])
    if not kept.all():
        i = int(kept.argmin())
        raise CaptureError(
            f"{capture.names[i]}: distortion: the lens's terms {distortion[i].tolist()} fold the picture over or leave too little of it; "
            "correct the calibration, or undistort the images first"
        )
    bent = np.asarray(distortion.any(1))
    if capture.fisheye is not None:
        bent |= capture.fisheye > 0
    if bent.any():
        ctx.log(
            f"{bent.sum()} of {len(bent)} pictures are undistorted to pinhole cameras; what these show is "
            f"at least {kept[bent].min():.0%} of a picture's area, every pixel of it seen by the lens"
        )
    return result


def _check(capture: Capture, ctx: Context) -> None:
    """Decode every picture and mask once, so that a file that is cut short is found now and not hours later in training."""
    from ..vision.images.pictures import read_keep, read_mask, read_picture
    from .captures.checks import image_header

    jobs: list[tuple[str, Callable[..., Any]]] = [(name, read_picture) for name in dict.fromkeys(capture.images or ())]
    jobs += [(name, read_mask) for name in dict.fromkeys(m for m in capture.masks or () if m)]
    jobs += [(name, read_keep) for name in dict.fromkeys(m for m in capture.keeps or () if m)]

    one_at_a_time = Lock()

    def decode(job: tuple[str, Any]) -> str:
        name, read = job
        width, height, _ = image_header(capture.root, name)
        with one_at_a_time if width * height > _LARGE else nullcontext():
            read(capture.root, name)
        return name

    with ctx.progress(len(jobs), "check pictures") as progress, ThreadPoolExecutor(thread_count(_DECODE_THREADS)) as pool:
        for name in pool.map(decode, jobs):
            progress.advance(1, name)
