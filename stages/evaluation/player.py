"""The scene itself for the report: what the web player plays there."""

from __future__ import annotations

import numpy as np

from ...pipeline import ArtifactWriter
from ..artifacts.evaluate import write_player
from ..artifacts.frameset import FrameSet
from ..exports.web import light_web
from .judge import Judge

MOST = 8_000_000  # bytes; a report is a page that people send to one another


def write_scene(out: ArtifactWriter, judge: Judge, frames: FrameSet) -> None:
    """Writes the scene's file for the web player, with fewer SH bands if it is larger than `MOST`; nothing if that is not enough, or if no
    training frame has a pose to begin with."""
    if not len(frames.train):
        return
    found = light_web(judge.model, frames, len(np.unique(frames.time)), MOST)
    if found is not None:
        write_player(out, *found)
