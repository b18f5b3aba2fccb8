"""The scene itself for the report: what the web player plays there."""

from __future__ import annotations

import numpy as np

from ...pipeline import ArtifactWriter
from ..exports.web import light_web
from ..shared.posed_frameset import PosedFrameSet
from .artifact import write_player
from .judge import Judge

MOST = 8_000_000  # bytes; a report is a page that people send to one another


def write_scene(out: ArtifactWriter, judge: Judge, frames: PosedFrameSet) -> str | None:
    """Writes the scene's file for the web player, with fewer SH bands if it is larger than `MOST`. Returns the reason if it is left out."""
    if not len(frames.train):
        return "no training frame has a pose, so there is no place to look from"
    try:
        found = light_web(judge.model, frames, len(np.unique(frames.time)), MOST)
    except (ValueError, np.linalg.LinAlgError) as error:  # the measured results matter more than the player
        return str(error)
    if found is None:
        return f"it takes more than {MOST / 1e6:.0f} MB"
    write_player(out, *found)
    return None
