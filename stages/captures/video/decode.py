"""Decodes the pictures of a video that are taken, one after the other."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from ....pipeline import CaptureError, thread_count
from ..reading import Video
from ..video_files import open_video
from .colour import frame_tags, rgb_of
from .fields import deinterlaced
from .shape import STRAIGHT, alike, shape_of
from .survey import Survey, decoded_frames, survey
from .tracks import best_track

_FEW = 0.05  # share of the pictures that may be missing


def decode(
    root: Path,
    video: Video,
    width: int,
    height: int,
    crop: np.ndarray | None = None,
    tell: Callable[[str], None] | None = None,
    turn: int = 1,
) -> Iterator[np.ndarray]:
    """Yields the taken frames in order, uint8 [H,W,3] RGB, SDR, upright, with square pixels, scaled to width x height. crop: left, top,
    width, height of the part of each shown frame that is used, px; None for the whole frame. tell: gets a line about what only decoding
    shows. turn: the EXIF orientation by which shown frames are turned before that.

    Only two frames are in memory at a time, and a few more of interlaced video. A picture that cannot be decoded is replaced by the
    nearest one, if they are few. Raises `CaptureError`, naming file and frame, for damaged data, for pictures that change their shape,
    and if many of the frames cannot be decoded.
    """
    import av

    found = survey(root, video.file)
    if len(found.seconds) != video.total:
        raise CaptureError(f"{video.file}: {len(found.seconds)} frames, but {video.total} when it was read first; run again")
    say = tell or (lambda line: None)
    checked = _Checked(video.file, found)
    try:
        with open_video(root, video.file) as container:
            stream = best_track(container, video.file)
            stream.thread_type = "AUTO"
            stream.codec_context.thread_count = thread_count()
            frames = _numbered(decoded_frames(container, stream), found)
            frames = checked.pass_on(frames, stream.codec_context)
            frames = deinterlaced(frames, found.parity) if found.parity else frames
            for frame in _taken(frames, video, found, say):
                yield _picture(frame, found, width, height, crop, turn)
    except (av.FFmpegError, OSError, ValueError) as error:
        why = getattr(error, "strerror", None) or error  # PyAV's own text begins with a number
        raise CaptureError(f"{video.file}: frame {checked.number}: cannot be decoded ({why}); copy or record the video again") from error
    if checked.scaled:
        say(f"{video.file}: {checked.scaled} frames have another size and the same shape; they are scaled")


def _numbered(frames: Iterator[Any], found: Survey) -> Iterator[tuple[int | None, Any]]:
    """(number among the pictures shown, frame); None for a frame that the survey does not know."""
    if found.by_order:
        yield from enumerate(frames)
        return
    places: dict[int | None, list[int]] = defaultdict(list)
    for place in range(len(found.raw) - 1, -1, -1):
        places[found.raw[place]].append(place)
    last = -1
    for frame in frames:
        ahead = places[frame.pts]
        while ahead and ahead[-1] <= last:
            ahead.pop()
        number = ahead.pop() if ahead else None
        last = last if number is None else number
        yield number, frame


class _Checked:
    """Passes frames on, checks them, and remembers the number of the last one."""

    def __init__(self, name: str, found: Survey) -> None:
        self.name, self.found = name, found
        self.number, self.scaled = 0, 0

    def pass_on(self, frames: Iterator[tuple[int | None, Any]], context: Any) -> Iterator[tuple[int | None, Any]]:
        first = self.found.shape.shown
        for number, frame in frames:
            if number is None:
                continue
            self.number = number
            if frame.is_corrupt:
                raise CaptureError(f"{self.name}: frame {number}: the picture is damaged; copy or record the video again")
            size = shape_of(frame, self.found.pixel).shown
            if size != first:
                if not alike(size, first):
                    raise CaptureError(
                        f"{self.name}: frame {number}: {size[0]}x{size[1]}, but the video begins with {first[0]}x{first[1]}; cut it into "
                        "parts of one size"
                    )
                self.scaled += 1
            yield number, frame
            self.number = number + 1


def _taken(frames: Iterator[tuple[int | None, Any]], video: Video, found: Survey, say: Callable[[str], None]) -> Iterator[Any]:
    """The frames of `video.taken`; for a missing one the nearest in time."""
    wanted = iter(video.taken)
    target = next(wanted, None)
    before: tuple[int, Any] | None = None
    count = replaced = 0
    for number, frame in frames:
        if number is None or number >= video.total:
            continue
        count += 1
        while target is not None and target < number:
            replaced += 1
            seconds = found.seconds
            is_nearer = before is not None and seconds[target] - seconds[before[0]] <= seconds[number] - seconds[target]
            yield before[1] if before is not None and is_nearer else frame
            target = next(wanted, None)
        if number == target:
            yield frame
            target = next(wanted, None)
        before = (number, frame)
    missing = video.total - count
    if before is None or missing > max(1, _FEW * video.total):
        at = 0 if before is None else before[0] + 1
        raise CaptureError(f"{video.file}: frame {at}: {video.total} frames in the file, only {count} decode; copy or record it again")
    while target is not None:
        replaced += 1
        yield before[1]
        target = next(wanted, None)
    if missing:
        verb = "is" if replaced == 1 else "are"
        say(f"{video.file}: {missing} of {video.total} frames lack pictures; {replaced} of those taken {verb} replaced by the nearest one")


def _picture(frame: Any, found: Survey, width: int, height: int, crop: np.ndarray | None, turn: int) -> np.ndarray:
    from ....vision.images.pictures import resize, turned

    tags = frame_tags(frame, found.tags)
    shape = shape_of(frame, found.pixel)
    rgb = rgb_of(frame, tags)
    if shape.turn != STRAIGHT:
        rgb = np.ascontiguousarray(shape.turned(rgb))
    if crop is not None:  # it is in pixels of the shape as shown
        rgb = resize(rgb, *found.shape.shown)
    return resize(turned(rgb, turn), width, height, crop)
