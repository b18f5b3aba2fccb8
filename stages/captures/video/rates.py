"""Whether the cameras of a rig, whose frames are paired by number, ran at one rate."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from .survey import Survey
from .together import told_together

_APART = 0.5  # frames by which two clocks may differ at the end


def rig_told(headers: Mapping[str, Survey]) -> tuple[str, ...]:
    """The lines about the videos of a rig, and one that warns if equal frame numbers are not equal times by the videos' own clocks."""
    first, one = next(iter(headers.items()))
    gap = float(np.median(np.diff(one.seconds))) if len(one.seconds) > 1 else 0.0
    apart = {
        name: float(np.abs(np.subtract(other.seconds, one.seconds)).max())
        for name, other in headers.items()
        if len(other.seconds) == len(one.seconds)
    }
    worst = max(apart, key=lambda name: apart[name])
    lines = told_together(headers)
    if not gap or apart[worst] <= _APART * gap + 1e-3:
        return lines
    others = sum(value > _APART * gap + 1e-3 for value in apart.values()) - 1
    who = f"{worst} and {others} more" if others else worst
    return (
        *lines,
        f"{who}: {len(one.seconds)} frames in {headers[worst].seconds[-1]:.2f} s, but {first} has as many in {one.seconds[-1]:.2f} s; "
        "frames of one number are taken to be of one time, so check that all cameras ran at one rate",
    )
