"""Converts artifacts to the inputs of training: posed views and measured flow."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch

from ...pipeline import Artifact, StageError
from ...scene.model import Model
from ...scene.views import Views
from ..flow.artifact import StoredFlow
from .frameset import FrameSet
from .posed_frameset import PosedFrameSet

STATIC_WEIGHT = 0.1  # factor on the weight of measured flow where nothing moves
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


def measured_flow(flow: Artifact | None, views: Views):
    """``frame -> (flow [h, w, 2] px, weight [h, w] in [0, 1])`` at half resolution, or None if nothing was measured.

    The weight is the flow's confidence, reduced to a tenth where nothing moves. There the flow comes from the cameras alone and teaches
    little (primitives in front of these pixels must not move), yet these many pixels would outweigh the moving ones.
    """
    if flow is None or not (stored := StoredFlow(flow)).measured:
        return None
    pairs = {first: p for p, (first, second) in enumerate(stored.pairs) if int(views.next[first]) == second}
    trained = {int(i) for i in views.train}

    def of_frame(i: int):
        p = pairs.get(int(i))
        if p is None or int(views.next[i]) not in trained:
            return None
        size = views.size(0.5)
        shrink = np.array([size[0] / views.width, size[1] / views.height], np.float32)
        field = cv2.resize(stored.forward(p).astype(np.float32), size, interpolation=cv2.INTER_AREA) * shrink
        weight = cv2.resize(stored.confidence(p), size, interpolation=cv2.INTER_AREA).astype(np.float32) / 255
        if stored.has_moving:
            moves = cv2.resize(stored.moving(int(i)), size, interpolation=cv2.INTER_AREA).astype(np.float32) / 255
            weight = weight * (STATIC_WEIGHT + (1 - STATIC_WEIGHT) * moves)
        kept = views.kept(int(i), 0.5)
        if kept is not None:
            weight = weight * kept.cpu().numpy()
        return torch.from_numpy(np.ascontiguousarray(field)), torch.from_numpy(weight)

    return of_frame
