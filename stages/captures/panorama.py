"""Videos and pictures that show all around in one picture, as 360-degree cameras make them: no lens that poses are found for sees so much.

What counts is what the file states: the spherical mapping of a video (Google's Spherical Video, V1 and V2), the GPano tags of a picture.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ...pipeline import CaptureError
from ...vision.images.files import BadImageError, open_image

_FLAT = 4  # FFmpeg's number for rectilinear, which spatial videos of phones state
_PROJECTIONS = {  # FFmpeg's other numbers: (what it is, name in the filter v360)
    0: ("a 360-degree video", "e"),
    1: ("a 360-degree video (cube map)", "c3x2"),
    2: ("a 360-degree video", "e"),
    3: ("a 180-degree video", "hequirect"),
}
_OTHER = ("a video of another projection than a flat view", "fisheye")
_GPANO = re.compile(rb"GPano:ProjectionType\s*(?:=\s*[\"']|>)\s*equirectangular", re.IGNORECASE)


def refuse_video(frame: Any, name: str) -> None:
    """Raises CaptureError if the decoded `frame` of the video `name` is no flat view."""
    from av.sidedata.sidedata import Type

    data = frame.side_data.get(Type.SPHERICAL)
    projection = _FLAT if data is None else int.from_bytes(bytes(data)[:4], "little")
    if projection != _FLAT:
        what, form = _PROJECTIONS.get(projection, _OTHER)
        raise CaptureError(f"{name}: {what}, which is not read as it is; {_advice(form, 'mp4')}")


def refuse_pictures(root: Path, names: Sequence[str], sizes: Sequence[tuple[int, int]]) -> None:
    """Raises CaptureError if pictures are twice as wide as high and say that they show all around. names: paths relative to `root`. sizes:
    width and height of each, px. Parts of a panorama, as phones stitch them, have other shapes."""
    wide = [name for name, (width, height) in zip(names, sizes, strict=True) if abs(width - 2 * height) <= 2]
    round_about = [name for name in wide if _says_so(root / name)]
    if round_about:
        many = f" ({len(round_about)} of {len(names)} pictures are)" if len(names) > 1 else ""
        raise CaptureError(f"{round_about[0]}: a 360-degree picture{many}, which is not read as it is; {_advice('e', 'jpg')}")


def _advice(form: str, suffix: str) -> str:
    command = f"ffmpeg -i FILE -vf v360={form}:flat:h_fov=90:v_fov=60 flat.{suffix}"
    return f"reframe it to a flat view, with Insta360 Studio, GoPro Player or {command}"


def _says_so(file: Path) -> bool:
    """By the XMP data of a JPEG, where such cameras and stitchers write it."""
    try:
        with open_image(file) as image:
            segments: Any = getattr(image, "applist", [])  # of a JPEG; older versions of Pillow do not have XMP in `info`
            return any(content.startswith(b"http://ns.adobe.com/xap/") and _GPANO.search(content) for _, content in segments)
    except BadImageError:  # its reader says why
        return False
