"""Describes, in sentences for people, what a reconstruction covers: which frames are missing, and what may help."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

FEW_FEATURES = 200  # an image with fewer is dark, blurred or plain
HIGH_ERROR = 1.5  # px; a good reconstruction stays below 1
NARROW = 2.5  # degrees; below this, depth is known only to about a tenth


@dataclass(frozen=True)
class Coverage:
    """`registered` of `total` images have a pose. `gaps`: runs (first, last) of frames without one. `advice`: sentences for people."""

    registered: int
    total: int
    gaps: tuple[tuple[int, int], ...]
    advice: tuple[str, ...]

    def summary(self) -> str:
        """One line: `80 of 90 frames registered; without a pose: 40-49`."""
        missing = "" if not self.gaps else f"; without a pose: {spans(self.gaps)}"
        return f"{self.registered} of {self.total} frames registered{missing}"


def runs(missing: np.ndarray) -> tuple[tuple[int, int], ...]:
    """Maximal runs (first, last) of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], missing, [False]]).astype(np.int8)))
    return tuple((int(a), int(b) - 1) for a, b in zip(edges[::2], edges[1::2]))


def spans(gaps: Sequence[tuple[int, int]]) -> str:
    """`3, 7-9, 12 and 4 more`."""
    text = ", ".join(str(a) if a == b else f"{a}-{b}" for a, b in gaps[:8])
    return text + (f" and {len(gaps) - 8} more" if len(gaps) > 8 else "")


def frames_named(frames: Sequence[int]) -> str:
    """`frame 3` or `frames 3, 7-9`, from indices in any order."""
    missing = np.zeros(max(frames) + 1, bool)
    missing[list(frames)] = True
    return f"{'frame' if missing.sum() == 1 else 'frames'} {spans(runs(missing))}"


def cover(
    registered: np.ndarray,
    features: Sequence[int],
    parts: Sequence[int],
    matcher: str,
    error: float,
    angle: float = 90.0,
    doubtful: np.ndarray | None = None,
) -> Coverage:
    """Coverage and advice. registered [F] bool; features: count in each image; parts: images in each separate part, disjoint, the one that
    is kept first; error: mean reprojection error in px; angle: median angle in degrees between the outermost rays of a point;
    doubtful [F] bool: frames whose poses explain few of the matches (`pose_agreement.doubtful`)."""
    missing = ~np.asarray(registered, bool)
    gaps = runs(missing)
    counts = np.asarray(features)
    advice = []
    if gaps:
        other = "--set poses.matcher=exhaustive" if matcher != "exhaustive" else "--set poses.max_features=16384"
        poor = missing & (counts < FEW_FEATURES)
        why = (
            f"{int(poor.sum())} of them show fewer than {FEW_FEATURES} features (dark, blurred or plain)"
            if poor.any()
            else "motion blur, too little overlap with the others, or mostly moving things in view"
        )
        advice.append(
            f"{frames_named(np.flatnonzero(missing).tolist())} did not register: {why}; try {other}, "
            "or take more frames there (frames.every, frames.max_frames)"
        )
    rest = [size for size in parts[1:] if size >= 3]
    if rest:
        advice.append(
            f"the images fell into {1 + len(rest)} parts that share too little ({', '.join(map(str, [parts[0], *rest][:5]))} images); "
            f"the first is kept, the {sum(rest)} images of the others are left out: add views between them or try "
            "--set poses.matcher=exhaustive"
        )
    if doubtful is not None and doubtful.any():
        advice.append(
            f"{frames_named(np.flatnonzero(doubtful).tolist())}: the poses are doubtful, because they explain far fewer matches than each "
            "pair of frames does on its own; blur, or something that moves along with the camera, may have misled them. If the result "
            "is bad there, take these frames out of the capture"
        )
    if angle < NARROW:
        advice.append(
            f"points are seen under a median angle of {angle:.1f} degrees: the camera hardly moves sideways, so depth is uncertain; "
            "walk farther around the scene, or take frames from farther apart (frames.every)"
        )
    if error > HIGH_ERROR:
        advice.append(
            f"the mean reprojection error is {error:.2f} px, a good one is below 1: try --set poses.camera_model=OPENCV for a strong lens, "
            "and check for a rolling shutter or a zoom during the capture"
        )
    return Coverage(int((~missing).sum()), len(missing), gaps, tuple(advice))
