"""The skipped-frames split (`frames.every_time`): some times train, and the pictures that the same cameras took at the others test."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ....pipeline import CaptureError


def skipped_times(given: Path, train: np.ndarray, camera: np.ndarray, time: np.ndarray, every: int) -> np.ndarray:
    """Which of the ``train`` [F] frames lie at times that are skipped, bool [F]. The first time trains, then every ``every``-th one.

    Times are counted over all cameras together, so a rig trains on every camera of a time or on none. camera [F]: index. time [F].

    Raises CaptureError if fewer than two times would train, or if no camera saw several times: then a skipped time would be a new view,
    too.
    """
    times, rank = np.unique(np.round(time[train], 9), return_inverse=True)
    setting = f"{given}: frames.every_time={every}"
    if len(times) < 2:
        raise CaptureError(f"{setting} tests the times between those that train, and here all frames have one time; leave it unset")
    if all(len(np.unique(time[train & (camera == one)])) < 2 for one in np.unique(camera[train])):
        raise CaptureError(
            f"{setting} needs a camera that saw several times, and here each training frame is from a camera of its own; "
            "leave it unset and use the test views of the files, or frames.holdout"
        )
    if len(times) <= every:
        raise CaptureError(f"{setting} would train on one of {len(times)} times; choose at most {len(times) - 1}")
    result = np.zeros(len(train), bool)
    result[np.flatnonzero(train)[rank % every > 0]] = True
    return result


def told(split: np.ndarray, time: np.ndarray, every: int) -> str:
    """A sentence for people. split [F]: 0 train, 1 val, 2 test."""
    trained, all_times = (len(np.unique(np.round(time[kept], 9))) for kept in (split == 0, split != 1))
    test, val = int((split == 2).sum()), int((split == 1).sum())
    also = f", and the {val} that the files hold out are val" if val else ""
    return f"frames.every_time={every}: trains on {trained} of {all_times} times; {test} pictures of the other times are test{also}"
