"""When each frame was taken, by which camera, for which split, and which frame follows it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ....pipeline import CaptureError
from ..reading import DEFAULT_FPS, TEST, TRAIN, VAL, Options, Reading, Shot
from . import skipped_times as skipping

LEAST_TIMES = 3  # of training, from which their span says something
FEW = 3  # frames, of which the first would be a third or half
MOST_SPAN = 10.0  # ratio of the span of held-out times to that of the training times


class Timeline(NamedTuple):
    """Of F frames: split, camera, next, time and seconds [F], as in a `Capture`. times, cameras: how many there are. static: whether all
    frames show one time. notes: for people."""

    split: np.ndarray
    camera: np.ndarray
    time: np.ndarray
    seconds: np.ndarray
    next: np.ndarray
    times: int
    cameras: int
    static: bool
    notes: tuple[str, ...]


def timeline(given: Path, reading: Reading, options: Options) -> Timeline:
    """Times in [0, 1], splits and pairs of the frames of ``reading``. given: the file or folder that messages name. Raises CaptureError if
    none is left for training."""
    shots = reading.shots
    notes: tuple[str, ...] = ()
    split = _splits(given, reading, options)
    raw = np.array([s.time for s in shots], dtype=np.float64)
    if reading.has_split and not options.static:
        _same_unit(given, reading, split, raw)
    time = np.zeros_like(raw) if options.static else _unit_times(raw)
    times = len(np.unique(np.round(time, 9)))
    static = options.static or times == 1
    fps = options.fps or reading.fps or DEFAULT_FPS
    steps = [t * (times - 1) if s.step is None else s.step for s, t in zip(shots, time, strict=True)]
    seconds = np.array([step / fps if s.seconds is None else s.seconds for s, step in zip(shots, steps, strict=True)])
    index = {key: i for i, key in enumerate(sorted({s.camera for s in shots}))}
    camera = np.array([index[s.camera] for s in shots], dtype=np.int32)
    if options.every_time > 1:
        left_out = skipping.skipped_times(given, split == TRAIN, camera, time, options.every_time)
        split[split != TRAIN] = VAL  # new views apart from new times: one mean of both would say little about either
        split[left_out] = TEST
        notes = (skipping.told(split, time, options.every_time),)
    following = np.full(len(shots), -1, np.int32) if static else _next_frames(shots, camera, time, split)
    return Timeline(split, camera, time, seconds, following, times, len(index), static, notes)


def told_rate(kind: str, reading: Reading, options: Options, when: Timeline) -> list[str]:
    """A line where nothing says how fast pictures follow. In D-NeRF's sets times are shares of the whole."""
    if when.static or kind == "dnerf" or options.fps or reading.fps or all(shot.seconds is not None for shot in reading.shots):
        return []
    return [
        f"no file says how fast the pictures follow each other: {DEFAULT_FPS:g} a second are assumed; --set frames.fps=24 for another rate "
        "(of no account if nothing moves)"
    ]


def _splits(given: Path, reading: Reading, options: Options) -> np.ndarray:
    """[F] uint8: the splits of the files, or every N-th frame held out, but none of `FEW` frames that are fewer than N. Raises CaptureError
    if no frame is for training."""
    split = np.array([s.split for s in reading.shots], dtype=np.uint8)
    enough = len(split) > FEW or len(split) >= options.holdout
    if not reading.has_split and options.holdout and enough and options.every_time == 1:
        split[np.arange(len(split)) % options.holdout == 0] = TEST
    if not (split == TRAIN).any():
        own = "use frames.holdout=0, or 2 and more"
        advice = "check the split files" if reading.has_split and options.holdout != 1 else own
        raise CaptureError(f"{given}: {len(split)} frames, none of them for training; {advice}")
    return split


def _same_unit(given: Path, reading: Reading, split: np.ndarray, raw: np.ndarray) -> None:
    """Raises CaptureError if held-out views span so much more time than those for training that their times must be in another unit."""
    train = raw[split == TRAIN]
    for held_out, name in ((VAL, "validation"), (TEST, "test")):
        times = raw[split == held_out]
        if len(times) and len(np.unique(train)) >= LEAST_TIMES and np.ptp(times) > MOST_SPAN * np.ptp(train):
            raise CaptureError(
                f"{given}: the times of the {name} views span {np.ptp(times):g}, those for training {np.ptp(train):g} "
                f"({', '.join(reading.sources[:3])}): they must be in the same unit; correct the times of one of them"
            )


def _unit_times(raw: np.ndarray) -> np.ndarray:
    """Times of all splits together, rescaled to exactly [0,1]; 0 if all are equal. Motion, exports and the player cover that interval."""
    span = raw.max() - raw.min()
    return (raw - raw.min()) / span if span > 0 else np.zeros_like(raw)


def _next_frames(shots: Sequence[Shot], camera: np.ndarray, time: np.ndarray, split: np.ndarray) -> np.ndarray:
    """Index of the same camera's train frame at its next time, -1 if none.

    Held-out frames have no next frame and are skipped, so that flow is never measured on a picture that is used for evaluation. Pictures
    of different sizes form no pair: scaled to a common size, they would seem to move. Nor do pictures with a cut between them.
    """
    result = np.full(len(shots), -1, np.int32)
    for key in np.unique(camera):
        members = np.flatnonzero(camera == key)
        members = members[np.argsort(time[members], kind="stable")].tolist()
        last, linked = -1, True
        for i in members:
            if split[i] == TRAIN:
                if last >= 0 and linked and time[i] > time[last] and shots[last].size == shots[i].size:
                    result[last] = i
                last, linked = i, True
            linked = linked and shots[i].linked
    return result
