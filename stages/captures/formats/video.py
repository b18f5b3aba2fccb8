"""A video file: one camera over time. Supports any codec that PyAV reads, in the containers that `video_files.py` allows."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

from ....pipeline import CaptureError
from .. import checks
from ..listing.beside import alone
from ..posed.camera_matrix import CAMERA_MATRIX, read_camera_matrix
from ..posed.camera_matrix import told as told_matrix
from ..reading import Options, Reading, Shot, Video
from ..video.decode import decode
from ..video.survey import survey
from ..video.together import told_together

__all__ = ["MOST_FRAMES", "choose", "decode", "detect", "read", "refuse_one", "survey"]

MOST_FRAMES, MOST_OF_MOVING = 200, 600  # of a camera; of a clip in which things move, as they are a blur between frames far apart


def detect(root: Path) -> str | None:
    file = _file(root)
    return None if file is None else f"the video {file.name}"


def read(root: Path, options: Options) -> Reading:
    path = _file(root)
    if path is None:
        raise CaptureError(f"{root}: no video here, or several; pass the one video file")
    base = root if root.is_dir() else root.parent
    checks.resolve_inside(base, path.name, path.name)
    header = survey(base, path.name)
    total = len(header.seconds)
    taken = choose(total, options, MOST_FRAMES if options.static else MOST_OF_MOVING)
    if total < 2:
        raise CaptureError(f"{path.name}: one frame alone has no pose and no depth; pass a longer video of the scene")
    refuse_one(path.name, taken, total, options)
    step = taken[1] - taken[0]
    some = f"all {total} video frames" if step == 1 else f"{len(taken)} of {total} video frames (every {step})"
    begin = header.seconds[0]
    hint = read_camera_matrix(base, CAMERA_MATRIX, header.width, header.height) if root.is_dir() or alone(path) else None
    return Reading(
        why=f"video {path.name}, {total} frames, one camera over time",
        shots=[
            Shot(f"{path.name}#{i}", 0, header.seconds[i], (header.width, header.height), seconds=header.seconds[i] - begin) for i in taken
        ],
        fps=header.fps,
        sources=() if hint is None else (CAMERA_MATRIX,),
        K_hint=hint,
        videos=(Video(path.name, 0, taken, total),),
        notes=(
            f"took {some}; frames.every and frames.max_frames change it",
            *told_together({path.name: header}),
            *told_matrix(hint, CAMERA_MATRIX, header.width, header.height),
        ),
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


def _file(root: Path) -> Path | None:
    """`root` itself if it is a file, or the only video of a folder without images; otherwise None."""
    if root.is_file():
        return root
    names = [name for name in checks.list_folder(root) if (root / name).is_file()]
    videos = [name for name in names if name.lower().endswith(checks.VIDEO_SUFFIXES)]
    has_images = any(name.lower().endswith(checks.IMAGE_SUFFIXES) for name in names)
    return root / videos[0] if len(videos) == 1 and not has_images else None
