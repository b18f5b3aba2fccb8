"""Decides whether structure from motion gains by ignoring features on moving objects, and runs a second pass that does. This code runs in
the parent process and does not import pycolmap."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...pipeline.files import written_beside
from ...vision.sfm.coverage import frames_named
from ...vision.sfm.masks import on_moving
from ...vision.sfm.pose_agreement import Matches, agreement, doubtful
from ...vision.sfm.runner import Progress, WorkerError, finished, run_worker
from .moving_masks import FEWEST, lens_moving_masks

if TYPE_CHECKING:
    from ..shared.frameset import FrameSet

LEAST = 0.1  # share of a frame's used features; outliers of a tenth, all to one side, shift a Cauchy estimate by 0.15 sigma of a feature
KEPT = ("the first pass", "the second pass, without them,")
TURNS = "the camera turns and hardly moves: its rotations are found from the whole picture, so no other motion can be separated from them"
Result = tuple[dict[str, np.ndarray], dict[str, Any]]


@dataclass(frozen=True)
class Passes:
    """The result to continue with, the share of the first pass's used features that lie on moving objects (None: not determined), and what
    was done, for people."""

    arrays: dict[str, np.ndarray]
    facts: dict[str, Any]
    moving_share: float | None
    told: str
    trouble: str = ""  # error message of a second pass that failed


def needless(frames: FrameSet, static: bool, registered: np.ndarray) -> str | None:
    """Why moving objects are not searched for; None if one camera has enough registered frames."""
    if static:
        return "static capture: nothing moves"
    if max(np.bincount(np.asarray(frames.camera)[registered]), default=0) < FEWEST:
        return f"no camera has {FEWEST} frames with a pose, so moving objects cannot be found"
    return None


def second_pass(frames: FrameSet, request: Mapping[str, Any], folder: Path, first: Result, static: bool, bars: Progress) -> Passes:
    """The better of two passes: `first`, the result of `run_worker(request, folder)`, and a second one without the features on moving
    objects.

    Masks come from flow and the first pass's poses (`lens_moving_masks`). Frames with doubtful poses get masks from flow alone: if the
    poses follow a person, that person seems to stand still, and would mislead the second pass as well. If no frame has a share of `LEAST`
    of its used features on masks, there is nothing to gain and no second pass: bundle adjustment tolerates that many outliers. If a second
    pass fails or is no better, the first is kept. A killed run resumes where it stopped.
    """
    arrays, facts = first
    why = TURNS if facts.get("turning") else needless(frames, static, arrays["registered"])
    if why is not None:
        return Passes(arrays, facts, None, why)
    file = folder / "moving.npz"
    masks = _masks(frames, arrays, file, bars)
    share, shares = moving_shares(masks, arrays)
    worst = int(shares.argmax())
    percent = f"{100 * share:.1f} % of the features used lie on moving objects, {100 * shares[worst]:.1f} % in frame {worst}"
    aside = np.flatnonzero(doubtful(arrays))
    if len(aside):
        percent += f" (found without poses in {frames_named(aside.tolist())}, because the first pass explains few of the matches there)"
    if shares[worst] < LEAST:
        return Passes(arrays, facts, share, f"no second pass: {percent}, the most; {100 * LEAST:g} % would do no harm")
    request = {**request, "task": "reconstruct_masked", "first": str(folder), "masks": str(file)}
    below = folder / "masked"
    try:
        again = finished(request, below) or run_worker(request, below, bars)
    except WorkerError as error:
        return Passes(arrays, facts, share, f"{percent}; the second pass without them failed, the first is kept", str(error))
    better, words = choose_pass(arrays, again[0])
    return Passes(*(again if better else first), share, f"{percent}; {words}")  # type: ignore[misc]


def moving_shares(masks: np.ndarray, arrays: Mapping[str, np.ndarray]) -> tuple[float, np.ndarray]:
    """Share of the triangulated features that lie on the masks [F, h, w]: over all frames, and for each frame [F]; 0 without features."""
    moving = on_moving(masks, arrays["seen"], arrays["seen_xy"], arrays["size"])
    used, hit = (np.bincount(arrays["seen"], weights, len(masks)) for weights in (None, moving.astype(np.float64)))
    return float(hit.sum() / max(1, used.sum())), hit / np.maximum(used, 1)


def choose_pass(first: Mapping[str, np.ndarray], second: Mapping[str, np.ndarray]) -> tuple[bool, str]:
    """Whether the second pass is better, and why. The pass with more registered images wins; if equal, the one whose cameras explain the
    larger share of the matches off moving pixels.

    first, second: arrays of `reconstruct`; second also has the matches (`match_pair`, `match_xy1`, `match_xy2`) by which both are judged.
    """
    counts = [int(arrays["registered"].sum()) for arrays in (first, second)]
    if counts[0] != counts[1]:
        better = counts[1] > counts[0]
        return better, f"{KEPT[better]} is kept: {max(counts)} frames registered in it, {min(counts)} in the other"
    common = first["registered"] & second["registered"]
    matches = Matches(second["match_pair"], second["match_xy1"], second["match_xy2"])
    shares = [agreement(matches, arrays, common) for arrays in (first, second)]
    better = bool(shares[1] > shares[0])
    explained = f"its cameras explain {100 * max(shares):.2f} % of the matches off moving pixels, the other's {100 * min(shares):.2f} %"
    return better, f"{KEPT[better]} is kept: {explained}"


def _masks(frames: FrameSet, arrays: Mapping[str, np.ndarray], file: Path, bars: Progress) -> np.ndarray:
    """Masks of moving pixels by the first pass's poses where these can be trusted, cached in `file` with the sizes of the pictures."""
    if file.is_file():
        with np.load(file, allow_pickle=False) as kept:
            return np.asarray(kept["masks"])
    done = 0

    def advance() -> None:
        nonlocal done
        done += 1
        bars("moving", done, len(frames))

    bars("moving", 0, len(frames))
    K, poses, distortion, size = (arrays[name] for name in ("K", "cam_from_world", "distortion", "size"))
    masks = lens_moving_masks(frames, K, poses, distortion, size, advance, doubtful(arrays))
    with written_beside(file) as part:
        np.savez_compressed(part, allow_pickle=False, masks=masks, size=arrays["size"])
    return masks
