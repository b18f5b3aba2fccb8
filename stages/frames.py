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
from .captures.facts import Facts
from .estimates import picture_resources

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
    version = 5  # 5: `untimed` is told
    items = "cameras"
    inputs = ()
    settings = FramesSettings
    reads_capture = True

    def applies(self, facts: Mapping[str, Any], settings: FramesSettings) -> Applies:
        known = Facts.of(facts)
        action = "pictures stay in their files" if known.images_in_files else "pictures are decoded from video"
        return Applies.yes(f"{known.frames} frames, {action}")

    def estimate(self, facts: Mapping[str, Any], settings: FramesSettings) -> float | None:
        """Decoding once, two cores: about 60 megapixels a second from image files, 15 from video into the store (measured)."""
        known = Facts.of(facts)
        new = (known.cameras if known.new_items is None else known.new_items) / known.cameras
        megapixels = new * known.frames * known.width * known.height / 1e6
        return 0.5 + megapixels / (60 if known.images_in_files else 15)

    def item_parts(self, given: Given) -> Sequence[Any]:
        """The videos, each of which is a camera; [] where pictures stay in their files."""
        from .frames_videos import video_parts

        capture = _recognised(given)
        return video_parts(capture, given) if capture.images is None else []

    def resources(self, facts: Mapping[str, Any], settings: FramesSettings, device: str) -> Resources:
        return picture_resources(Facts.of(facts), 0.3)

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
    from .artifacts.frames import StoredFrames

    K = None
    if capture.K is not None and capture.distortion is not None:
        K = _pinholes(capture, capture.K, capture.distortion, ctx)
    StoredFrames(
        facts=Facts.of(capture.facts),
        names=capture.names,
        background=capture.background,
        camera=capture.camera,
        time=capture.time,
        seconds=capture.seconds,
        split=capture.split,
        next=capture.next,
        K=K,
        cam_from_world=capture.cam_from_world,
        distortion=capture.distortion,
        lens_K=capture.K if K is not None and (K != capture.K).any() else None,
        fisheye=None if K is None else capture.fisheye,
        crop=capture.crop,
        points=capture.points,
        point_colors=capture.point_colors,
        files=capture.images,
        mask_files=capture.masks,
        keep_files=capture.keeps,
        keep_turns=None if capture.keeps is None else capture.keep_turns or (),
        K_hint=capture.K_hint,
    ).write(ctx.out, capture.notes)


def _pinholes(capture: Capture, K: np.ndarray, distortion: np.ndarray, ctx: Context) -> np.ndarray:
    """K of the pinhole cameras to which the pictures are undistorted; says what of them is lost."""
    import numpy as np

    from ..vision.images.lenses import pinholes

    facts = Facts.of(capture.facts)
    result, kept = pinholes(K, distortion, capture.fisheye, facts.width, facts.height)
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
