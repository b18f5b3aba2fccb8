"""Exports a `flow` artifact as files for other programs: .flo, and PNG pictures of flow, edges and moving pixels."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

from ...pipeline import thread_count
from ...pipeline.files import write_atomically
from ...vision.flow.colours import colour_wheel, flow_colours, typical_largest
from ...vision.flow.flo import write_flo
from ...vision.images.overlay import EDGE_COLOUR, MASK_STRENGTH, MOVING_COLOUR, overlay
from ...vision.images.png import encode_png
from ..flow.artifact import StoredFlow
from ..shared.frameset import FrameSet
from .numbered import INDEX, indexed, listed, staged

SUFFIXES = (".flo", ".png", "_backward.flo", "_backward.png", "_edges.png", "_moving.png")
ENDINGS = (".flo", ".png")
WHEEL = "wheel.png"
WHEEL_SIZE = 256  # px
SAMPLED_PAIRS = 32  # about as many pairs determine which flow length gets full colour


def export_flow(fields: StoredFlow, frames: FrameSet, out: Path, largest: float, advance: Callable[[], None] = lambda: None) -> int:
    """Writes the files of every pair, named by `pair_stems` plus one of `SUFFIXES`, and the legend `WHEEL`. Returns the number of files.

    .flo files hold the measured flow in px, .png files its colours, with full colour at ``largest`` px. Edges, and moving pixels if known,
    are drawn over the first frame. Files go to ``out`` when all are written, in place of those that the index of an earlier export lists.
    The index names the frames and times of each file. ``advance`` is called after each pair. Raises OSError if a file cannot be written,
    and ArtifactError or CaptureError if one cannot be read.
    """
    with staged(out) as part:
        written = _write_pairs(fields, frames, part, largest, advance)
        made = sorted(part.iterdir())
        (part / INDEX).write_text(json.dumps(indexed(out) | _index(fields, frames, {file.name for file in made}), indent=1) + "\n")
        for file in [file for ending in ENDINGS for file in listed(out, ending)]:
            file.unlink()
        os.replace(part / INDEX, out / INDEX)  # before the files, so that none of them is ever there without being listed
        for file in made:
            os.replace(file, out / file.name)
    return written


def _index(fields: StoredFlow, frames: FrameSet, made: set[str]) -> dict[str, dict[str, object]]:
    """What the index says of the files ``made``, by their ending: the two frames of each, their times in [0, 1] and in seconds."""
    span = float(np.ptp(frames.seconds))
    rows: dict[str, list[dict[str, object]]] = {ending: [] for ending in ENDINGS}
    for stem, pair in zip(pair_stems(frames.names, fields.pairs), fields.pairs):
        times = [float(frames.time[k]) for k in pair]
        about = {"frames": [frames.names[k] for k in pair], "time": times, "seconds": [t * span for t in times]}
        for name in (stem + suffix for suffix in SUFFIXES if stem + suffix in made):
            rows[name[-4:]].append({"file": name, **about})
    return {ending: {"format": "flow", "files": files} for ending, files in rows.items()}


def _write_pairs(fields: StoredFlow, frames: FrameSet, out: Path, largest: float, advance: Callable[[], None]) -> int:
    stems = pair_stems(frames.names, fields.pairs)
    write_atomically(out / WHEEL, encode_png(colour_wheel(WHEEL_SIZE)))

    def write(p: int) -> int:
        first = fields.pairs[p][0]
        for direction, field in (("", fields.forward(p)), ("_backward", fields.backward(p))):
            write_flo(out / f"{stems[p]}{direction}.flo", field)
            write_atomically(out / f"{stems[p]}{direction}.png", encode_png(flow_colours(field, largest)))
        picture = frames.composited(first)
        write_atomically(out / f"{stems[p]}_edges.png", encode_png(overlay(picture, fields.edges(first), EDGE_COLOUR)))
        moving = fields.moving_pixels(first, int(frames.camera[first]))
        if moving is None:
            return len(SUFFIXES) - 1
        covered = overlay(picture, moving, MOVING_COLOUR, MASK_STRENGTH)
        write_atomically(out / f"{stems[p]}_moving.png", encode_png(covered))
        return len(SUFFIXES)

    written = 1
    pool = ThreadPoolExecutor(thread_count(8))
    try:
        for count in pool.map(write, range(len(fields.pairs))):
            written += count
            advance()
    finally:
        pool.shutdown(cancel_futures=True)  # after an error or Ctrl-C, do not start the remaining pairs
    return written


def common_largest(fields: StoredFlow) -> float:
    """Flow length in px that gets full colour in all pictures: `typical_largest` over a sixteenth of the pixels of up to `SAMPLED_PAIRS`
    pairs."""
    every = max(1, -(-len(fields.pairs) // SAMPLED_PAIRS))
    return typical_largest(*(fields.forward(p)[::4, ::4] for p in range(0, len(fields.pairs), every)))


def pair_stems(names: Sequence[str], pairs: Sequence[tuple[int, int]]) -> list[str]:
    """ "<first>_<second>" for each pair, from the frames' names made safe for files: letters, digits, '.', '_', '-', no '.' first.

    If two files would get the same name (ignoring case), or names would not sort as the pairs do, which is by camera and time, every stem
    is prefixed with the number of its pair.
    """
    safe = [re.sub(r"[^A-Za-z0-9._-]+", "-", name).strip("-.")[:80] or "frame" for name in names]
    stems = [f"{safe[first]}_{safe[second]}" for first, second in pairs]
    files = {(stem + suffix).lower() for stem in stems for suffix in SUFFIXES}
    sort = all(sorted(named) == named for named in ([stem + suffix for stem in stems] for suffix in SUFFIXES))
    if sort and len(files) == len(SUFFIXES) * len(stems):
        return stems
    digits = len(str(len(pairs)))
    return [f"{p:0{digits}d}-{stem}" for p, stem in enumerate(stems)]
