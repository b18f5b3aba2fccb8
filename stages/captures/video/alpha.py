"""Whether a video has an alpha channel, which is not read: its pictures come without it."""

from __future__ import annotations

from typing import Any

_BESIDE = "alpha_mode"  # Matroska's tag for alpha of VP8 and VP9, which is a second stream beside the pictures
_DECODERS = {"vp8": "libvpx", "vp9": "libvpx-vp9"}  # FFmpeg's own decoders leave that stream out


def alpha_told(frame: Any, stream: Any) -> str | None:
    """A line if the video of `stream` has alpha, by its first `frame` or its tag, with the command for a capture that keeps it."""
    codec = stream.codec_context.name
    beside = any(name.lower() == _BESIDE and value == "1" for name, value in stream.metadata.items())
    if not beside and not any(component.is_alpha for component in frame.format.components):
        return None
    if codec == "gif" and frame.to_ndarray(format="rgba")[..., 3].min() == 255:  # decoded with alpha, whatever it has
        return None
    decoder = f"-c:v {_DECODERS[codec]} " if beside and codec in _DECODERS else ""
    return (
        "its alpha channel is not read, so what lies behind shows; PNG keeps it, in a folder FRAMES of its own: "
        f"ffmpeg {decoder}-i FILE -pix_fmt rgba FRAMES/%05d.png"
    )
