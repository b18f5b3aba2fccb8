"""Small videos for tests, made with PyAV, and changes to their bytes that recorders and editors make."""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np

SIZE = (64, 48)
GOP = "keyint=8:min-keyint=8:scenecut=0:bframes=2:b-adapt=0"


def levels(count: int, step: int = 10, size: tuple[int, int] = SIZE) -> list[np.ndarray]:
    """Grey pictures: picture k has level 20 + step k."""
    return [np.full((size[1], size[0], 3), 20 + step * k, np.uint8) for k in range(count)]


def encode(
    file: Path,
    pictures: Sequence[np.ndarray],
    codec: str = "libx264",
    options: dict[str, str] | None = None,
    stamps: Sequence[int] | None = None,
    rate: int = 10,
    base: Fraction | None = None,
    pixel: Fraction | None = None,
    pix_fmt: str = "yuv420p",
) -> Path:
    base = base or Fraction(1, rate)
    with av.open(str(file), "w") as container:
        stream = container.add_stream(codec, rate=rate, options={"threads": "1", **(options or {})})
        stream.height, stream.width = pictures[0].shape[:2]
        stream.pix_fmt, stream.time_base, stream.codec_context.time_base = pix_fmt, base, base
        if pixel:
            stream.codec_context.sample_aspect_ratio = pixel
        for k, picture in enumerate(pictures):
            frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(picture), format="rgb24")
            frame.pts, frame.time_base = k if stamps is None else stamps[k], base
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    return file


def remux(source: Path, target: Path, change: Callable[[list[Any]], list[Any]], tag: Callable[[Any], None] | None = None) -> Path:
    """Writes the packets of `source`, as `change` returns them, to another file."""
    with av.open(str(source)) as a, av.open(str(target), "w") as b:
        stream = b.add_stream_from_template(a.streams.video[0])
        if tag:
            tag(stream.codec_context)
        for packet in change([packet for packet in a.demux(video=0) if packet.size]):
            packet.stream = stream
            b.mux(packet)
    return target


def with_data(packet: Any, data: bytes) -> Any:
    """A packet of other content with the same time stamps."""
    other = av.Packet(data)
    other.pts, other.dts, other.time_base, other.is_keyframe = packet.pts, packet.dts, packet.time_base, packet.is_keyframe
    return other


def from_key(number: int) -> Callable[[list[Any]], list[Any]]:
    """A change that keeps the packets from a key packet on, as a cut without encoding does."""

    def change(packets: list[Any]) -> list[Any]:
        keys = [k for k, packet in enumerate(packets) if packet.is_keyframe]
        return packets[keys[number] :]

    return change


def turn(file: Path, *matrix: float) -> Path:
    """Sets a, b, c and d of the display matrix of an MP4's track."""
    a, b, c, d = (round(value * 65536) for value in matrix)
    data = bytearray(file.read_bytes())
    struct.pack_into(">9i", data, data.index(b"tkhd") + 44, a, b, 0, c, d, 0, 0, 0, 1 << 30)
    file.write_bytes(data)
    return file


def box(kind: bytes, content: bytes) -> bytes:
    return struct.pack(">I4s", 8 + len(content), kind) + content


def with_cover(file: Path) -> Path:
    """Puts a cover in front of an MP4's track, so that FFmpeg counts it as stream 0."""
    import io

    from PIL import Image

    picture = io.BytesIO()
    Image.new("RGB", (640, 480)).save(picture, "JPEG")
    data = file.read_bytes()
    at = data.rindex(b"moov") - 4
    assert at > data.index(b"mdat"), "the offsets of the samples do not change"
    moov = data[at:]
    cover = box(b"covr", box(b"data", struct.pack(">II", 13, 0) + picture.getvalue()))
    handler = box(b"hdlr", bytes(8) + b"mdirappl" + bytes(9))
    first = 8 + struct.unpack(">I", moov[8:12])[0]  # behind mvhd
    about = box(b"udta", box(b"meta", bytes(4) + handler + box(b"ilst", cover)))
    file.write_bytes(data[:at] + box(b"moov", moov[8:first] + about + moov[first:]))
    return file
