"""Messages for captures whose cameras cannot be found, with a likely cause and a remedy."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from .coverage import FEW_FEATURES

FIXED = 0.005  # of the longer side; if matches move less than this in nine of ten pairs, the camera hardly moves
TURNED = 0.8  # share of the pairs that one homography explains
LINKED = 0.5  # share of the images that have a verified pair


def nothing_registered(frames: int, features: Sequence[int], pairs: Mapping[str, Any], matcher: str) -> str:
    """The likeliest cause, then what to do about it. features [n]: count in each image; pairs: what `survey` found about matches."""
    median = int(np.median(features)) if len(features) else 0
    other = "poses.matcher=exhaustive" if matcher != "exhaustive" else "poses.max_features=16384"
    bring = "provide poses in the files (transforms.json, a COLMAP model) instead"
    matched = np.asarray(pairs["matched"])
    if median < FEW_FEATURES:
        cause = f"most frames show fewer than {FEW_FEATURES} features: they are dark, blurred or plain"
        remedy = f"take sharper, brighter frames of a textured scene, or {bring}"
    elif not len(matched) or (matched > 0).mean() < LINKED:
        cause = f"{int((matched == 0).sum())} frames have no other frame that shows the same things"
        remedy = f"try --set {other}, or more frames (--set frames.every=1 or frames.max_frames=N)"
    elif pairs["shift"] < FIXED:
        cause = "the camera hardly moves, but shakes too much to count as one that stands still: matches stay within a few pixels"
        remedy = f"stabilise the video with another program, so that the camera stands still; or move it sideways, or {bring}"
    elif pairs["flat"] > TURNED:
        cause = "the camera only turns or zooms, or sees a single plane: one homography explains most pairs of frames"
        remedy = f"a camera that only turns cannot be reconstructed; move it sideways, or {bring}"
    else:
        cause = "no two frames show enough of the same static things from far enough apart"
        remedy = f"try --set {other}, or more frames (--set frames.every=1 or frames.max_frames=N), or {bring}"
    return (
        f"structure from motion found no cameras for the {frames} frames (median of {median} features an image, {matcher} matching): "
        f"{cause}. "
        "It needs a camera that moves sideways in front of a static, textured background, with most of each picture "
        f"seen again in the next; {remedy}"
    )
