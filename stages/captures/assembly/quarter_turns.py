"""Pictures that stand across most others, as those of a phone that was held both ways: a quarter turn saves them from being cropped."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from ....vision.images.pictures import CLOCKWISE
from .. import checks
from ..reading import Shot
from .common_size import Size, crop

_GAIN = 1.1  # times as much of a picture must be kept
_RIGHT, _LEFT = 6, 8  # EXIF orientations: clockwise, and back


def turned_alike(root: Path, shots: Sequence[Shot], common: Size, upright: bool) -> tuple[list[Shot], tuple[int, ...] | None]:
    """``shots`` with their cameras, those that stand across ``common`` turned, and the EXIF orientations by which; None if none are.

    upright: pictures already were turned as their EXIF data ask, and have no cameras. Those that stand across are then turned back to how
    they are stored, or as most of the others were, so that one lens remains one."""
    across = [_kept(s.size[::-1], common) > _GAIN * _kept(s.size, common) for s in shots]
    if not any(across):
        return list(shots), None
    own = [checks.orientation(root, str(s.file)) if upright else 1 for s in shots]
    usual = Counter(turn for turn, other in zip(own, across, strict=True) if not other and turn in (_RIGHT, _LEFT))
    side = usual.most_common(1)[0][0] if usual else _RIGHT
    back = {_RIGHT: _LEFT, _LEFT: _RIGHT}
    turns = tuple(back.get(turn, side) if other else 1 for turn, other in zip(own, across, strict=True))
    return [_turned(s) if turn > 1 else s for s, turn in zip(shots, turns, strict=True)], turns


def told(shots: Sequence[Shot], turns: tuple[int, ...] | None) -> list[str]:
    """A line about those that are turned."""
    if turns is None:
        return []
    first = next(s for s, turn in zip(shots, turns, strict=True) if turn > 1)
    seen = f"{sum(turn > 1 for turn in turns)} of {len(turns)} pictures stand across the others (first {first.name})"
    return [f"{seen}: they are turned by a quarter, so that less is cropped"]


def _kept(size: Size, common: Size) -> float:
    part = crop(size, common)
    return part[2] * part[3] / (size[0] * size[1])


def _turned(shot: Shot) -> Shot:
    """With the size of its turned picture and, if it has a camera, that of the picture turned clockwise."""
    width, height = shot.size
    K, pose, terms = shot.K, shot.cam_from_world, shot.distortion
    if K is not None:
        K = np.array([[K[1, 1], 0, height - K[1, 2]], [0, K[0, 0], K[0, 2]], [0, 0, 1]])
    if terms is not None and not shot.fisheye:  # p1 and p2 belong to axes
        terms = np.array([*terms[:2], terms[3], -terms[2], *terms[4:]])
    return replace(shot, size=(height, width), K=K, distortion=terms, cam_from_world=None if pose is None else CLOCKWISE @ pose)
