"""What training found of the clocks of a rig's cameras, for people."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from .frameset import FrameSet


def clock_lines(clocks: Mapping[int, float], frames: FrameSet) -> list[str]:
    """A line for each camera whose clock is off, see `Model.clocks`."""
    between = float(np.diff(np.unique(frames.time)).mean()) if len(np.unique(frames.time)) > 1 else 1.0
    lines = []
    for camera, late in sorted(clocks.items()):
        name = frames.names[int(np.flatnonzero(frames.camera == camera)[0])]
        lines.append(
            f"the clock of the camera of {name} is off: its pictures show what is {abs(late) / between:.2f} frames "
            f"{'later' if late > 0 else 'earlier'} than their times say, and are used so"
        )
    return lines
