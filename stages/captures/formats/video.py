"""A video file: one camera over time. Supports any codec that PyAV reads, in the containers that `video_files.py` allows."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ....pipeline import CaptureError, thread_count
from .. import checks
from ..reading import Options, Reading, Shot, Video
from ..video_files import MOST_FRAMES, open_video

DEFAULT_MAX_FRAMES = 200
_LARGE = 10 * 2**30  # bytes
_LEAST_USED = 0.01  # least share of a large file that must be video data


@dataclass(frozen=True)
class Header:
    """Facts about a video: size after rotation, time in seconds of every frame in display order, and frame rate."""

    width: int
    height: int
    seconds: tuple[float, ...]
    fps: float | None


def detect(root: Path) -> str | None:
    file = _file(root)
    return None if file is None else f"the video {file.name}"


def read(root: Path, options: Options) -> Reading:
    path = _file(root)
    if path is None:
        raise CaptureError(f"{root}: no video here, or several; pass the one video file")
    base = root if root.is_dir() else root.parent
    checks.resolve_inside(base, path.name, path.name)
    header = probe(base, path.name)
    total = len(header.seconds)
    most = options.usual.frames if options.usual else DEFAULT_MAX_FRAMES
    taken = choose(total, options, most)
    if total < 2:
        raise CaptureError(f"{path.name}: one frame alone has no pose and no depth; pass a longer video of the scene")
    refuse_one(path.name, taken, total, options)
    step = taken[1] - taken[0]
    begin = header.seconds[0]
    return Reading(
        why=f"video {path.name}, {total} frames, one camera over time",
        shots=[
            Shot(f"{path.name}#{i}", 0, header.seconds[i], (header.width, header.height), seconds=header.seconds[i] - begin) for i in taken
        ],
        fps=header.fps,
        usual_frames=most if options.usual and total > most and not (options.max_frames or options.every) else None,
        videos=(Video(path.name, 0, taken, total),),
        notes=(f"took {len(taken)} of {total} video frames (every {step}); frames.every and frames.max_frames change it",),
    )


def choose(total: int, options: Options, default_max: int | None) -> tuple[int, ...]:
    """Indices of the frames to take: every `every`-th frame, or if unset the smallest step with at most `max_frames` frames."""
    limit = options.max_frames or default_max
    step = options.every or (max(1, math.ceil(total / limit)) if limit else 1)
    return tuple(range(0, total, step))


def refuse_one(name: str, taken: Sequence[int], total: int, options: Options) -> None:
    """Raises CaptureError, naming the setting, if only one of several frames without poses is taken."""
    if len(taken) < 2:
        cause = "max_frames" if options.every is None else "every"
        change = "raise" if options.every is None else "lower"
        raise CaptureError(f"{name}: frames.{cause}={getattr(options, cause)} leaves {len(taken)} of {total} frames, too few; {change} it")


def probe(root: Path, name: str) -> Header:
    """Reads all packets, but decodes only the first frame, which has the rotation. Refuses broken and truncated files."""
    import av

    try:
        with open_video(root, name) as container:
            stream = _stream(container, name)
            promised = stream.frames
            base = float(stream.time_base or 0)
            stamps: list[int | None] = []
            size, used, there = (root / name).stat().st_size, 0, 0
            for packet in container.demux(stream):
                there += packet.size > 0
                if packet.size and not packet.is_discard:  # an edit list discards what was trimmed without encoding again
                    if packet.is_corrupt:
                        raise CaptureError(f"{name}: frame {len(stamps)}: the file is damaged or cut short here; copy it again")
                    stamps.append(packet.pts)
                    used += packet.size
                    if len(stamps) > MOST_FRAMES:
                        raise CaptureError(f"{name}: more than {MOST_FRAMES} frames; cut the video to the part that you mean")
            rate = float(stream.average_rate) if stream.average_rate else None
        with open_video(root, name) as container:
            frame = next(container.decode(_stream(container, name)), None)
            if frame is None:
                raise CaptureError(f"{name}: frame 0: nothing can be decoded; copy or record the video again")
            width, height = (frame.height, frame.width) if frame.rotation % 180 else (frame.width, frame.height)
    except (av.FFmpegError, OSError, ValueError) as error:
        raise CaptureError(f"{name}: not a readable video, perhaps cut short ({error}); copy it again or convert it to MP4") from error
    if there < promised:
        raise CaptureError(f"{name}: frame {len(stamps)}: the file promises {promised} frames and ends here, cut short; copy it again")
    if size > _LARGE and used < _LEAST_USED * size:  # every command reads the whole file to see whether it changed
        raise CaptureError(
            f"{name}: {used} bytes of pictures in a file of {size / 1e9:.0f} GB, damaged; copy it again or convert it to MP4"
        )
    if not stamps:
        raise CaptureError(f"{name}: holds no frames; copy or record the video again")
    known = sorted(p for p in stamps if p is not None)
    if len(known) == len(stamps) and len(set(known)) == len(known) and base > 0:
        seconds = tuple((p - known[0]) * base for p in known)
    else:  # raw streams carry no time stamps
        seconds = tuple(i / (rate or 30.0) for i in range(len(stamps)))
    return Header(width, height, seconds, rate)


def decode(root: Path, video: Video, width: int, height: int, crop: np.ndarray | None = None) -> Iterator[np.ndarray]:
    """Yields the taken frames in order, uint8 [H,W,3] RGB, upright, scaled to width x height. crop: left, top, width, height of the part
    of each frame that is used, px; None for the whole frame.

    Only one frame is in memory at a time. Raises `CaptureError`, naming file and frame, for damaged data and if fewer frames can be
    decoded than the file has.
    """
    import av

    wanted = iter(video.taken)
    target = next(wanted, None)
    index = 0
    try:
        with open_video(root, video.file) as container:
            stream = _stream(container, video.file)
            stream.thread_type = "AUTO"
            stream.codec_context.thread_count = thread_count()
            for frame in container.decode(stream):
                if frame.is_corrupt:
                    raise CaptureError(f"{video.file}: frame {index}: the picture is damaged; copy or record the video again")
                if index == target:
                    yield _picture(frame, width, height, crop)
                    target = next(wanted, None)
                index += 1
    except (av.FFmpegError, OSError, ValueError) as error:
        raise CaptureError(f"{video.file}: frame {index}: cannot be decoded ({error}); copy or record the video again") from error
    if index < video.total:
        raise CaptureError(f"{video.file}: frame {index}: {video.total} frames in the file, only {index} decode; copy or record it again")


def _picture(frame: Any, width: int, height: int, crop: np.ndarray | None) -> np.ndarray:
    from ....vision.images.pictures import resize

    rgb = frame.to_ndarray(format="rgb24")
    turns = round(frame.rotation / 90) % 4  # counter-clockwise, as for np.rot90
    if turns:
        rgb = np.rot90(rgb, turns)
    return np.ascontiguousarray(resize(np.ascontiguousarray(rgb), width, height, crop))


def _stream(container: Any, name: str) -> Any:
    if not container.streams.video:
        raise CaptureError(f"{name}: holds no video stream; pass a video file")
    return container.streams.video[0]


def _file(root: Path) -> Path | None:
    """`root` itself if it is a file, or the only video of a folder without images; otherwise None."""
    if root.is_file():
        return root
    names = [name for name in checks.list_folder(root) if (root / name).is_file()]
    videos = [name for name in names if name.lower().endswith(checks.VIDEO_SUFFIXES)]
    has_images = any(name.lower().endswith(checks.IMAGE_SUFFIXES) for name in names)
    return root / videos[0] if len(videos) == 1 and not has_images else None
