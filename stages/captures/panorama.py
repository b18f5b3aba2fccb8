"""Videos and pictures that show all around in one picture, as 360-degree cameras make them: no lens that poses are found for sees so much.

What counts is what the file states: the spherical mapping of a video (Google's Spherical Video, V1 and V2), the GPano tags of a picture.
Exports that were encoded again state nothing, so what is twice as wide as high is looked at.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ...pipeline import CaptureError
from ...pipeline.choice.evenly import evenly
from ...vision.images.files import BadImageError, open_image

LOOKED_AT = 5  # pictures, of which more than half must show all around, and two
SEAM, NOISE = 1.5, 2.0  # how much more the outermost columns may differ than neighbours do, and levels that coding adds
STRUCTURE = 5.0  # levels by which the outermost columns vary, and differ from those close by: plain edges say nothing
DISTINCT = 0.6  # how much the outermost columns may differ, of what they do from those close by
POLE = 0.33  # how much the top and bottom rows may vary, of what the others do
_WIDTH = 512  # px, at which pictures are compared
_FLAT = 4  # FFmpeg's number for rectilinear, as spatial videos state
_PROJECTIONS = {  # FFmpeg's other numbers: (what it is, name in the filter v360)
    0: ("a 360-degree video", "e"),
    1: ("a 360-degree video (cube map)", "c3x2"),
    2: ("a 360-degree video", "e"),
    3: ("a 180-degree video", "hequirect"),
}
_OTHER = ("a video of another projection than a flat view", "fisheye")
_SEEN = "its right edge goes on at its left one, and its top and bottom rows are of one colour each"
_GPANO = re.compile(rb"GPano:ProjectionType\s*(?:=\s*[\"']|>)\s*equirectangular", re.IGNORECASE)


def refuse_video(frame: Any, name: str, spread: Iterable[Any] = ()) -> None:
    """Raises CaptureError if the decoded `frame` of the video `name` is no flat view. spread: frames from all of it, asked for if it states
    nothing."""
    from av.sidedata.sidedata import Type

    data = frame.side_data.get(Type.SPHERICAL)
    if data is not None:
        projection = int.from_bytes(bytes(data)[:4], "little")
        if projection != _FLAT:
            raise _refused(name, *_PROJECTIONS.get(projection, _OTHER))
    elif _is_wide(frame.width, frame.height):
        shown = [shows_all_around(other.to_ndarray(format="gray")) for other in spread]
        if _most(sum(shown), len(shown)):
            raise _refused(name, f"a 360-degree video ({_SEEN})", seen=True)


def refuse_pictures(root: Path, names: Sequence[str], sizes: Sequence[tuple[int, int]]) -> None:
    """Raises CaptureError if pictures are twice as wide as high and state, or show, that they show all around. names: paths relative to
    `root`. sizes: width and height of each, px. Parts of a panorama, as phones stitch them, have other shapes."""
    wide = [name for name, size in zip(names, sizes, strict=True) if _is_wide(*size)]
    if stated := [name for name in wide if _tells(root / name, _states_it)]:
        many = f" ({len(stated)} of {len(names)} pictures are)" if len(names) > 1 else ""
        raise _refused(stated[0], f"a 360-degree picture{many}", suffix="jpg")
    looked_at = evenly(wide, LOOKED_AT)
    seen = [name for name in looked_at if _tells(root / name, lambda image: shows_all_around(np.asarray(image.convert("L"))))]
    if _most(len(seen), len(looked_at)):
        many = f"{_SEEN}, as in {len(seen)} of {len(looked_at)} pictures looked at"
        raise _refused(seen[0], f"a 360-degree picture ({many})", suffix="jpg", seen=True)


def _is_wide(width: int, height: int) -> bool:
    return abs(width - 2 * height) <= 2


def _most(count: int, total: int) -> bool:
    return count > max(1, total / 2)


def _refused(name: str, what: str, form: str = "e", suffix: str = "mp4", seen: bool = False) -> CaptureError:
    command = f"ffmpeg -i FILE -vf v360={form}:flat:h_fov=90:v_fov=60 flat.{suffix}"
    advice = f"reframe it to a flat view, with Insta360 Studio, GoPro Player or {command}"
    return CaptureError(
        f"{name}: {what}, which is not read as it is; {advice}{'; if it is a flat view, cut some pixels off one side' if seen else ''}"
    )


def _tells(file: Path, ask: Callable[[Any], bool]) -> bool:
    try:
        with open_image(file) as image:
            return ask(image)
    except BadImageError:  # its reader says why
        return False


def _states_it(image: Any) -> bool:
    """By the XMP data of a JPEG, where such cameras and stitchers write it."""
    segments = getattr(image, "applist", [])  # of a JPEG; older versions of Pillow do not have XMP in `info`
    return any(content.startswith(b"http://ns.adobe.com/xap/") and _GPANO.search(content) for _, content in segments)


def shows_all_around(picture: np.ndarray) -> bool:
    """Whether ``picture`` [H,W] uint8 goes on at its left edge where its right one ends, and its top row and its bottom row show one
    direction each. Edges are compared within 45 degrees of the horizon, as columns hardly differ near the poles."""
    import cv2

    end = max(1, len(picture) // _WIDTH)
    small, *poles = (
        cv2.resize(np.ascontiguousarray(rows), (_WIDTH, high), interpolation=cv2.INTER_AREA).astype(np.float64)
        for rows, high in ((picture, _WIDTH // 2), (picture[:end], 1), (picture[-end:], 1))
    )
    band = small[_WIDTH // 8 : -_WIDTH // 8]

    def apart(a: int, b: int) -> float:
        return float(np.abs(band[:, a] - band[:, b]).mean())

    far, seam, beside = _WIDTH // 32, apart(0, -1), (apart(0, 1) + apart(-1, -2)) / 2
    near = min(apart(0, far), apart(-1, -1 - far), apart(far // 2, -1 - far // 2))
    lively = min(near, *(band[:, edge].std() for edge in (0, -1))) >= STRUCTURE
    even = max(row.std() for row in poles) <= POLE * band.std(1).mean()
    return bool(lively and even and seam <= DISTINCT * near and seam <= SEAM * beside + NOISE)
