"""`PosedFrameSet`: frames of a capture whose cameras are known. Imports no torch."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ...pipeline import Artifact, StageError
from .frameset import FrameSet


class PosedFrameSet(FrameSet):
    """A `FrameSet` with poses, from the files or from structure from motion: K [F,3,3] and cam_from_world [F,4,4] are never None.

    Raises StageError if neither artifact has poses."""

    K: np.ndarray
    cam_from_world: np.ndarray

    def __init__(self, frames: Artifact, root: Path, poses: Artifact | None = None) -> None:
        super().__init__(frames, root, poses)
        if self.K is None or self.cam_from_world is None:
            raise StageError(f"{root}: its files give no poses, and no result of `poses` was given")
