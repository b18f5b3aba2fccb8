"""Measures flicker over time in renders from the capture's fixed cameras."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import nullcontext
from itertools import pairwise
from typing import Any

import numpy as np

from ...pipeline import Progress
from ...scene.metrics.flicker import Flicker, steady_pixels
from ..shared.posed_frameset import PosedFrameSet
from .judge import Judge
from .spread import flicker_cameras, spread, stretches

FEWEST = 3  # least number of times of a camera


def measure_flicker(
    judge: Judge, frames: PosedFrameSet, most: int | None = None, progress: Callable[[int, str], Progress] | None = None
) -> dict[str, Any] | None:
    """`static`, `edges` and `warped` in 8-bit levels and `flow` in px, as means over `pairs` pairs of times of `cameras` cameras.
    `per_pair` has the four values of each pair with its `camera` and both `times`. None for captures without a fixed camera that saw
    several times. Held-out cameras are preferred if there are any. If they have more than ``most`` times together, stretches of
    neighbouring times are measured, spread evenly."""
    if not judge.fixed or judge.model.motion.static:
        return None
    seen: dict[int, list[int]] = {}
    for k in np.flatnonzero(frames.registered):
        seen.setdefault(int(frames.camera[k]), []).append(int(k))
    held_out = {int(frames.camera[i]) for i in np.flatnonzero(frames.registered & (frames.split > 0))}
    wholly = [camera for camera in seen if camera in held_out and not (frames.split[seen[camera]] == 0).any()]
    cameras = [camera for camera in (wholly or sorted(seen)) if len(seen[camera]) >= FEWEST]
    if not cameras:
        return None
    chosen = spread(cameras, flicker_cameras(max(len(seen[camera]) for camera in cameras)))
    flicker, pairs = Flicker(), []
    measured = {}
    for camera in chosen:
        order = sorted(seen[camera], key=lambda i: float(frames.time[i]))
        measured[camera] = stretches(order, len(order) if most is None else max(FEWEST, most // len(chosen)))
    total = sum(len(stretch) for each in measured.values() for stretch in each)
    with nullcontext() if progress is None else progress(total, "flicker") as bar:
        for camera, each in measured.items():
            steady = steady_pixels(frames.composited(i) / 255.0 for stretch in each for i in stretch)
            for stretch in each:
                flicker.begin(steady)
                for i in stretch:
                    flicker.add(judge.render(i)[0], frames.composited(i) / 255.0)
                    if bar is not None:
                        bar.advance(1)
                pairs += [{"camera": camera, "times": [float(frames.time[i]) for i in pair]} for pair in pairwise(stretch)]
    rows = [{**pair, **row} for pair, row in zip(pairs, flicker.rows, strict=True)]
    return {**flicker.means(), "cameras": len(chosen), "pairs": len(rows), "per_pair": rows}
