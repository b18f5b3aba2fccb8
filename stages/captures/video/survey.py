"""Surveys a video file: all of its packets and its first pictures, from which everything follows that decoding needs to know."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from fractions import Fraction
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from ....pipeline import CaptureError, thread_count
from ..listing.refusals import of_video
from ..listing.sidecars import log_curve
from ..panorama import LOOKED_AT, refuse_video
from ..video_files import open_video
from .alpha import alpha_told
from .colour import BY_LUT, Tags, colours_told, frame_tags, stream_tags, supposed_hd
from .fields import FieldTest
from .packets import Packets, read_packets
from .shape import Shape, eyes_told, is_plausible, shape_of, turn_told
from .times import Times, frame_rate, picture_times
from .tracks import best_track, other_tracks

LONG_GAP, LONG_GAPS = 10.0, 100.0  # s, and medians of the gaps between frames, above which a gap is spoken of

DEFAULT_RATE = 30.0  # frames per second of a raw stream that gives none
MOST_RATE = 480.0  # frames per second of a phone; higher ones, such as 1000 and 90000, are units of time
_RAW = ("m4v", "mjpeg", "h261", "h263", "h264", "hevc", "vvc", "vc1", "dirac", "obu", "mpegvideo")  # FFmpeg's names
_KEPT = 32  # surveys
_INTERLACED = (2, 3, 4, 5)  # FFmpeg's field orders
_LEAST_DECODED = 0.5  # share of the packets from the first picture on
_EPOCH = 1980  # a year; clocks that were never set give 1904 or 1970
_FIELDS = 0.8  # fewer pictures than this per packet: packets are fields


@dataclass(frozen=True)
class Survey:
    """seconds: time of each picture in the order shown, the first at 0. raw: their time stamps in the file, ticks. by_order: pictures are
    to be counted, because their stamps say nothing. pixel: width over height of a pixel, if the container says. parity: of the fields of
    interlaced video, None for whole frames. late: seconds by which the first picture comes after the start of the track. timecode: of that
    start. created: when the file was made, in seconds of the clock of Unix, if it says; some cameras write the end of the recording. notes:
    a line for every repair and for everything that is not read. width, height: as shown."""

    shape: Shape
    seconds: tuple[float, ...]
    raw: tuple[int | None, ...]
    by_order: bool
    fps: float | None
    tags: Tags
    pixel: Fraction | None
    parity: str | None
    late: float
    timecode: str | None
    created: float | None
    notes: tuple[str, ...]

    @property
    def width(self) -> int:
        return self.shape.shown[0]

    @property
    def height(self) -> int:
        return self.shape.shown[1]


@dataclass
class _First:
    """What the first pictures tell."""

    shape: Shape
    stamp: int | None
    pixel: Fraction | None
    lines: list[str | None]  # for people
    parity: str | None
    shown: list[int | None]  # stamps of the pictures that were decoded


def survey(root: Path, name: str) -> Survey:
    """Reads all packets, and decodes the first picture alone, or some seconds of interlaced video. Raises CaptureError for broken files."""
    try:
        state = (root / name).stat()
    except OSError as error:
        raise CaptureError(f"{name}: cannot be read ({error.strerror}); check the file and its permissions") from error
    return _survey(root, name, (state.st_ino, state.st_size, state.st_mtime_ns, state.st_ctime_ns))


@lru_cache(_KEPT)  # planning and decoding in one process both need it
def _survey(root: Path, name: str, state: tuple[int, ...]) -> Survey:
    import av

    try:
        with open_video(root, name) as container:
            stream = best_track(container, name)
            tags, pixel, notes = stream_tags(stream.codec_context), stream.sample_aspect_ratio, other_tracks(container, stream)
            packets = read_packets(container, stream, root / name, name)
            stated = float(stream.average_rate) if stream.average_rate else None
            code = stream.metadata.get("timecode") or container.metadata.get("timecode")
            created = _created(container.metadata.get("creation_time") or stream.metadata.get("creation_time"))
            even = _even_rate(container, stream)
            base, start = float(stream.time_base or 0), stream.start_time
            reordered = bool(stream.codec_context.has_b_frames)
            counted = container.format.name == "avi"  # stamps of AVI are those of decoding
        first = _first(root, name, tags, pixel)
        if packets.doubtful or len(first.shown) < _FIELDS * _until(packets, first):
            packets.stamps, reordered = _pictures(root, name), False
        times, late = _times(packets, first, reordered, counted, name)
    except (av.FFmpegError, OSError, ValueError) as error:
        raise CaptureError(f"{name}: {of_video(root / name, error)}") from error
    ticks = times.ticks
    seconds = (ticks - ticks[0]) * (base if not times.untimed and base > 0 else 1 / even)
    by_order = counted or times.untimed or first.stamp is None or first.stamp not in times.raw
    fps = even if times.untimed else frame_rate(seconds.tolist(), stated)
    behind = 0.0 if times.untimed or start is None else float(ticks[0] - start) * base
    return Survey(
        shape=first.shape,
        seconds=tuple(seconds.tolist()),
        raw=times.raw,
        by_order=by_order,
        fps=fps,
        tags=tags,
        pixel=first.pixel,
        parity=first.parity,
        late=behind if abs(behind) < 1e6 else 0.0,
        timecode=code,
        created=created,
        notes=(*notes, *_log_told(root, name), *_told(times, packets, late, first, even, seconds)),
    )


def _times(packets: Packets, first: _First, reordered: bool, counted: bool, name: str) -> tuple[Times, int]:
    """The times from the first picture on, and how many packets before it have no picture."""
    if counted:  # stamps of AVI are those of decoding, which are those of showing in another order
        known = sorted(p for p in packets.stamps if p is not None)
        return picture_times(known if len(known) == len(packets.stamps) else packets.stamps, False), 0
    times = picture_times(packets.stamps, reordered)
    if times.untimed or first.stamp is None or first.stamp not in times.raw:
        return times, 0
    late = times.raw.index(first.stamp)
    if len(times.raw) - late < _LEAST_DECODED * len(times.raw):
        raise CaptureError(
            f"{name}: frame 0: of {len(times.raw)} frames the first {late} cannot be decoded; copy or record the video again"
        )
    return Times(times.raw[late:], times.ticks[late:], times.repaired, times.jumps), late


def _first(root: Path, name: str, tags: Tags, pixel: Fraction | None) -> _First:
    with open_video(root, name) as container:
        stream = best_track(container, name)
        field_order, codec_tag = stream.codec_context.field_order, stream.codec_context.codec_tag
        frames = decoded_frames(container, stream)
        frame = next(frames, None)
        if frame is None or frame.is_corrupt:
            what = "nothing can be decoded" if frame is None else "the picture is damaged"
            raise CaptureError(f"{name}: frame 0: {what}; copy or record the video again")
        refuse_video(frame, name, _spread(root, name))
        pixel = pixel or stream.codec_context.sample_aspect_ratio
        own = frame_tags(frame, tags)
        colours = colours_told(own, name, codec_tag, supposed_hd(frame, own))
        lines = [eyes_told(frame, name), turn_told(frame), alpha_told(frame, stream), colours]
        found = _First(shape_of(frame, pixel), frame.pts, pixel, lines, None, [frame.pts])
        if frame.interlaced_frame or field_order in _INTERLACED:
            test, flagged = FieldTest(), False
            while frame is not None and not test.is_over:
                flagged |= frame.interlaced_frame
                test.add(frame)
                frame = next(frames, None)
                found.shown += [] if frame is None else [frame.pts]
            if flagged:
                found.parity = test.parity
                whole = "flagged as interlaced, but its frames are whole: left as they are"
                lines.append("interlaced: deinterlaced" if found.parity else whole)
    return found


def _until(packets: Packets, first: _First) -> int:
    """How many packets have stamps between those of the first and the last picture that was decoded."""
    known = [p for p in first.shown if p is not None]
    if len(known) < 4:
        return 0
    return sum(p is None or known[0] <= p <= known[-1] for p in packets.stamps if p is None or p <= known[-1])


def decoded_frames(container: Any, stream: Any) -> Iterator[Any]:
    """Frames in the order shown. Packets before the first key picture, which a cut leaves behind, may be impossible to decode."""
    import av

    begun = False
    for packet in container.demux(stream):
        begun |= packet.is_keyframe
        try:
            frames = packet.decode()
        except av.FFmpegError:
            if begun or not packet.size:
                raise
            continue
        yield from frames


def _pictures(root: Path, name: str) -> list[int | None]:
    """The time stamp of every picture, in the order shown. This decodes the whole file."""
    with open_video(root, name) as container:
        stream = best_track(container, name)
        stream.thread_type = "AUTO"
        stream.codec_context.thread_count = thread_count()
        return [frame.pts for frame in decoded_frames(container, stream)]


def _spread(root: Path, name: str) -> Iterator[Any]:
    """Key pictures from all of a video, or ones behind them; fewer where it cannot be sought."""
    import av

    with open_video(root, name) as container:
        stream, seen = best_track(container, name), set[int | None]()
        for k in range(LOOKED_AT):
            try:
                if k:
                    container.seek((container.start_time or 0) + k * (container.duration or 0) // LOOKED_AT)
                frame = next((frame for frame in decoded_frames(container, stream) if frame.pts not in seen), None)
            except av.FFmpegError:
                return
            if frame is not None:
                seen.add(frame.pts)
                yield frame


def _created(text: str | None) -> float | None:
    """Seconds of the clock of Unix; None without a date, and for that of a clock that was never set."""
    try:
        found = datetime.fromisoformat(text or "")
    except ValueError:
        return None
    return None if found.year < _EPOCH else (found if found.tzinfo else found.replace(tzinfo=UTC)).timestamp()


def _even_rate(container: Any, stream: Any) -> float:
    """Frames per second of a video without times: that of the codec's own header, or that of the container. A raw stream has no container,
    and FFmpeg states 25 for it."""
    rates = (stream.codec_context.framerate, None if container.format.name in _RAW else stream.average_rate)
    return next((float(rate) for rate in rates if rate and 1 <= rate <= MOST_RATE), DEFAULT_RATE)


def _log_told(root: Path, name: str) -> list[str]:
    found = log_curve(root, name)
    return [] if found is None else [f"recorded as {found[1]} ({found[0]}), which is not converted: {BY_LUT}"]


def _frames(count: int) -> str:
    return f"{count} frame{'s' if count != 1 else ''}"


def _gap(seconds: Sequence[float]) -> list[str]:
    """A line if far more time passes between two frames than between the others."""
    gaps = np.diff(seconds)
    if not len(gaps) or not gaps.max() > max(LONG_GAP, LONG_GAPS * float(np.median(gaps))):
        return []
    k = int(gaps.argmax())
    return [
        f"{gaps[k]:.4g} s pass between its frames {k} and {k + 1}; if nothing was paused there, its time stamps are wrong: encode it again"
    ]


def _told(times: Times, packets: Packets, late: int, first: _First, even: float, seconds: Sequence[float]) -> list[str]:
    shape, told = first.shape, list(_gap(seconds))
    if packets.trimmed:
        told.append(f"{_frames(packets.trimmed)} that its edit list hides: left out")
    if late:
        told.append(f"{_frames(late)} before the first that can be decoded: left out")
    if times.untimed:
        told.append(f"it has no time stamps that can be used: frames count as 1/{even:g} s apart")
    if times.jumps:
        told.append(f"its clock begins again {times.jumps} time{'s' if times.jumps != 1 else ''}; it is continued")
    if times.repaired:
        told.append(
            f"{times.repaired} of {len(times.raw) + late} time stamps are doubled, missing or out of order; they are placed between "
            "their neighbours"
        )
    if first.pixel and not is_plausible(first.pixel):
        told.append(f"pixels {first.pixel} times as wide as high are impossible; they count as square")
    if shape.square != shape.stored:
        ratio, stored, square = shape.pixel, "x".join(map(str, shape.stored)), "x".join(map(str, shape.square))
        told.append(f"pixels are {ratio.numerator}:{ratio.denominator} as wide as high: {stored} is scaled to {square}")
    return [*told, *filter(None, first.lines)]
