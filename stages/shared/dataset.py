"""The views that training and evaluation render, of the frames of a capture."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from ...pipeline import Artifact, StageError
from ...scene.model import Model
from ...scene.views import Views
from ..flow.artifact import StoredFlow
from .frameset import FrameSet
from .posed_frameset import PosedFrameSet

BACKGROUNDS = {"white": (1.0, 1.0, 1.0), "black": (0.0, 0.0, 0.0), None: (0.0, 0.0, 0.0)}


def load_frameset(inputs: Any, root: Path) -> PosedFrameSet:
    """The capture's frames, with poses from the files or from structure from motion."""
    return PosedFrameSet(inputs["frames"], root, inputs.get("poses"))


def load_views(frames: PosedFrameSet, flow: Artifact | None, device: str = "cpu", model: Model | None = None) -> Views:
    """Views of all frames, with their pictures on ``device``. If ``model`` is given, its near plane and background are used.

    ``train`` holds the registered training frames. If `flow` found that nothing moves in front of a moving camera, all frames have one
    time, as with `--static`. Raises StageError if no training frame has a pose."""
    if not len(frames.train):
        raise StageError(
            "no training frame has a pose; see the coverage report of `poses`, or use fewer held-out frames (--set frames.holdout=0)"
        )
    stored = None if flow is None else StoredFlow(flow)
    time = np.asarray(frames.time)
    if stored is not None and stored.static and not frames.fixed_cameras:
        time = np.zeros_like(time)
    return Views(
        K=frames.K,
        cam_from_world=frames.cam_from_world,
        time=time,
        camera=np.asarray(frames.camera),
        next=np.asarray(frames.next),
        train=np.asarray(frames.train),
        width=frames.width,
        height=frames.height,
        load=frames.composited,
        background=BACKGROUNDS[frames.background] if model is None else model.background,
        load_alpha=(lambda i: np.ascontiguousarray(frames.image(i)[..., 3])) if frames.alpha else None,
        load_kept=kept_pixels(frames) if frames.masked else None,
        load_moving=stored.moving if stored is not None and stored.has_moving and stored.has_ever_moving else None,
        stored_edges=stored.edges if stored is not None and stored.has_edges else None,
        recorder=np.arange(len(time)) if are_photos(frames, time) else None,
        device=device,
        near=Views.near if model is None else model.near,
        clocks={} if model is None else model.clocks,
    )


def kept_pixels(frames: FrameSet) -> Callable[[int], np.ndarray]:
    """A function that returns a frame's mask, uint8 [H, W]: 255 where pixels count, 0 where a mask excludes them."""

    def of_frame(i: int) -> np.ndarray:
        kept = frames.kept(i)
        return np.full((frames.height, frames.width), 255, np.uint8) if kept is None else np.where(kept, 255, 0).astype(np.uint8)

    return of_frame


def are_photos(frames: FrameSet, time: np.ndarray) -> bool:
    """Whether one camera photographed a static scene, so that each picture may have its own exposure and white balance. time [F]: equal
    for what shows one moment."""
    return len(np.unique(frames.camera)) == 1 and len(np.unique(time)) == 1 and not frames.alpha
