"""Which video track of a file is the video: the largest one that is not a cover, a thumbnail or a still, one in
colour before those of grey, which may be depth and infrared of a depth camera."""

from __future__ import annotations

from typing import Any

from ....pipeline import CaptureError


def best_track(container: Any, name: str) -> Any:
    """The stream to read; of equally large ones the file's default, then the first. Raises CaptureError if there is none."""
    streams = [stream for stream in container.streams.video if stream.codec_context is not None]
    shown = [stream for stream in streams if not _is_cover(stream)]
    if not shown:
        what = "only a cover picture, no video" if streams else "no video stream that can be read"
        raise CaptureError(f"{name}: holds {what}; pass a video file")
    moving = [stream for stream in shown if stream.frames != 1] or shown  # a poster may be larger than the video
    return max(moving, key=lambda stream: (not _is_grey(stream), stream.width * stream.height, _is_default(stream), -stream.index))


def other_tracks(container: Any, taken: Any) -> tuple[str, ...]:
    """A line for each video track that is not read."""
    return tuple(
        f"track {stream.index + 1}, {'the cover' if _is_cover(stream) else _size(stream)}, is not read"
        for stream in container.streams.video
        if stream.index != taken.index
    )


def _size(stream: Any) -> str:
    return "of an unknown kind" if stream.codec_context is None else f"{stream.width}x{stream.height}"


def _is_grey(stream: Any) -> bool:
    return str(stream.codec_context.pix_fmt).startswith("gray")


def _is_cover(stream: Any) -> bool:
    from av.stream import Disposition

    return bool(stream.disposition & (Disposition.attached_pic | Disposition.timed_thumbnails | Disposition.still_image))


def _is_default(stream: Any) -> bool:
    from av.stream import Disposition

    return bool(stream.disposition & Disposition.default)
