"""How the colours of a decoded frame are to be read: by its own tags, or by those of its container where it has none."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ....pipeline import CaptureError
from ....vision.images.coding_points import UNREAD_CURVES, UNREAD_GAMUTS, UNSPECIFIED, CodingPoints
from ....vision.images.wide_colour import to_sdr

# Values of ITU-T H.273, as FFmpeg gives them.
_UNREAD_MATRICES = {8: "YCgCo", 10: "BT.2020 with constant luminance", 11: "SMPTE 2085", 14: "ICtCp"}
_BT2020 = 9
_BT709 = 1
_HD = (1280, 720)  # px; from one of them on, players take BT.709 for a video that says nothing. FFmpeg's converter takes BT.601 for all.
_FULL_RANGE = 2
BY_LUT = "convert it to Rec.709 first by its LUT, for example with ffmpeg -i FILE -vf lut3d=LUT.cube NEW.mp4"
_DOLBY_VISION = ("dvh1", "dvhe", "dva1", "dvav", "dav1")


@dataclass(frozen=True)
class Tags(CodingPoints):
    """matrix: another number of H.273; 2 if unspecified."""

    matrix: int = 2


def stream_tags(context: Any) -> Tags:
    """Those of the container. They must be read before the decoder, which replaces them by its own, has begun."""
    return Tags(int(context.color_trc), int(context.color_primaries), int(context.colorspace))


def frame_tags(frame: Any, container: Tags) -> Tags:
    """Those of the frame, with those of the container in place of unspecified ones."""
    own = (int(frame.color_trc), int(frame.color_primaries), int(frame.colorspace))
    given = (container.transfer, container.primaries, container.matrix)
    return Tags(
        *(
            other if value in UNSPECIFIED and (k < 2 or value == 2) else value
            for k, (value, other) in enumerate(zip(own, given, strict=True))
        )
    )


def colours_told(tags: Tags, name: str, codec_tag: str, supposed: bool = False) -> str | None:
    """A line about what is done with the colours; None if they are plain. supposed: see `supposed_hd`. Raises CaptureError for
    colours that cannot be shown."""
    if tags.matrix in _UNREAD_MATRICES:
        raise CaptureError(
            f"{name}: colours coded as {_UNREAD_MATRICES[tags.matrix]}, which is not read; convert the video to BT.709 or HLG"
        )
    if codec_tag in _DOLBY_VISION and tags.transfer in UNSPECIFIED and tags.matrix in UNSPECIFIED:
        raise CaptureError(
            f"{name}: Dolby Vision without an HDR or SDR base (profile 5), which is not read; convert the video to HLG or SDR"
        )
    converted = tags.conversion("its")
    if tags.curve != "SDR":
        return converted
    said = [f"if it is log footage, as Apple Log with these tags is, {BY_LUT}"] if tags.primaries == _BT2020 and tags.transfer < 3 else []
    if tags.transfer in UNREAD_CURVES:
        said.append(
            f"its transfer curve ({UNREAD_CURVES[tags.transfer]}) is not converted, so its contrast differs from that of other cameras"
        )
    if tags.primaries in UNREAD_GAMUTS:
        said.append(f"its primaries ({UNREAD_GAMUTS[tags.primaries]}) are not converted, so its colours differ from those of other cameras")
    said += [converted] if converted else []
    if supposed:
        said.append("it does not state its colour matrix; because of its size BT.709 is taken, as players do")
    return "; ".join(said) or None


def supposed_hd(frame: Any, tags: Tags) -> bool:
    """Whether the matrix of a frame whose file states none is taken to be that of BT.709 because of its size, as players do."""
    large = frame.width >= _HD[0] or frame.height >= _HD[1]
    return large and tags.matrix in UNSPECIFIED and tags.gamut != "BT.2020" and not _is_rgb(frame)


def rgb_of(frame: Any, tags: Tags) -> np.ndarray:
    """The picture as stored, uint8 [H,W,3], SDR with the primaries of BT.709, coded as sRGB."""
    matrix = _BT709 if supposed_hd(frame, tags) else tags.matrix
    if matrix in UNSPECIFIED and not tags.is_plain and tags.gamut == "BT.2020" and not _is_rgb(frame):
        matrix = _BT2020
    if matrix != int(frame.colorspace):
        frame.colorspace = matrix
    if tags.is_plain:
        return frame.to_ndarray(format="rgb24")
    bits = max(component.bits for component in frame.format.components)
    if bits <= 8:
        return to_sdr(frame.to_ndarray(format="rgb24").astype(np.uint16), tags.curve, tags.gamut, white=255)
    # FFmpeg's conversion to 16 bits shifts full range to the left, and takes the white of limited range to 255/256 of the way
    full = frame.color_range == _FULL_RANGE or _is_rgb(frame)
    white = (2**bits - 1) << (16 - bits) if full else 255 << 8
    return to_sdr(frame.to_ndarray(format="rgb48le"), tags.curve, tags.gamut, white)


def _is_rgb(frame: Any) -> bool:
    return bool(frame.format.is_rgb)
