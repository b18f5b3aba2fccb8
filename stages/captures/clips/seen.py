"""What the first pictures of a video look like, made small: enough to tell passes from photographs, and versions from other views."""

from __future__ import annotations

from itertools import islice
from pathlib import Path

import numpy as np

from ....pipeline import CaptureError
from ..video.survey import decoded_frames
from ..video.tracks import best_track
from ..video_files import open_video

_SIDE = 48  # px
_EVERY, _UNTIL = 8, 25  # frames; many videos begin in black
_CHROMA = 16  # of 255, between the channels of a pixel, from which on it is coloured; codecs keep grey within a few levels
_COLOURED = 0.01  # of the pixels
_FLAT = 6.0  # of 255: standard deviation below which a picture shows nothing
_UNIT = 0.15  # by which the length of a normal may differ from 1
_NORMALS = 0.7  # of the pixels that are not background; photographs have about 0.4
_ALIKE = 0.95  # correlation of two versions; grades change the curve of the levels


def first_pictures(root: Path, name: str) -> np.ndarray:
    """uint8 [N,48,48,3] RGB: frames 0, 8, 16 and 24 of the video `root/name`, squeezed; N is 0 if it cannot be decoded."""
    import av

    found = []
    try:
        with open_video(root, name) as container:
            frames = decoded_frames(container, best_track(container, name))
            for frame in islice(frames, 0, _UNTIL, _EVERY):
                found.append(frame.reformat(width=_SIDE, height=_SIDE, format="rgb24").to_ndarray())
    except (av.FFmpegError, OSError, ValueError, CaptureError):  # its reader says why
        found = []
    return np.asarray(found, np.uint8).reshape(-1, _SIDE, _SIDE, 3)


def is_coloured(pictures: np.ndarray) -> bool:
    """Whether any of ``pictures`` uint8 [N,H,W,3] has colours."""
    spread = pictures.max(-1).astype(int) - pictures.min(-1)
    return any(one.mean() > _COLOURED for one in spread > _CHROMA)


def is_blank(pictures: np.ndarray) -> bool:
    """Whether each of ``pictures`` uint8 [N,H,W,3] has one level, so that they say nothing; also if there are none."""
    return all(one.std(axis=(0, 1)).max() < _FLAT for one in pictures)


def are_normals(pictures: np.ndarray) -> bool:
    """Whether the colours of ``pictures`` uint8 [N,H,W,3] are normals: c / 127.5 - 1 has length 1, but in a background of black, white or
    middle grey."""
    if not is_coloured(pictures):
        return False
    length = np.linalg.norm(pictures.reshape(-1, 3) / 127.5 - 1, axis=1)
    length = length[(length > 0.35) & (length < 1.7)]
    return bool(len(length)) and float((np.abs(length - 1) < _UNIT).mean()) >= _NORMALS


def look_alike(first: np.ndarray, second: np.ndarray) -> bool:
    """Whether two videos, by their pictures uint8 [N,H,W,3], show the same in other colours or sizes. False where pictures say nothing."""
    pairs = [(a.mean(-1).ravel(), b.mean(-1).ravel()) for a, b in zip(first, second, strict=False)]
    pairs = [(a, b) for a, b in pairs if min(a.std(), b.std()) >= _FLAT]
    return bool(pairs) and all(float(np.corrcoef(a, b)[0, 1]) >= _ALIKE for a, b in pairs)
