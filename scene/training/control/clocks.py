"""Finds by how much the clocks of a rig's cameras are off, from how the model of all of them moves."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import torch

from ...model import Model
from ...views import Views
from ..curriculum import MIN_CAMERAS, Curriculum

AT = 0.12, 0.16, 0.2, 0.25, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8  # of the training: each look finds what the model, which learned from wrong
# times so far, does not hide
RIGHT_AFTER = 4  # looks that find every clock right end the search
LOOKS, FEWEST, TOGETHER = 8, 4, 96  # frames of a camera, and the least number of them; frames of all cameras
HALF = 0.25  # frames before and after, from which the change of the picture over time is taken
LEAST, SURE = 0.05, 3.0  # frames, and standard errors, below which a clock is taken to be right
FARTHEST = 1.0  # frames, the most that is found: a camera that is off by more than a frame is to be cut, not corrected
OUTLIER = 0.1  # in [0, 1], error of a pixel that counts as one no motion explains


class ClockControl:
    """Moves the moments of ``views`` to where the pictures of each camera fit the motion of ``model``.

    total: steps of the training. active: whether to look at all. event: called with what was found.
    """

    def __init__(self, model: Model, views: Views, curriculum: Curriculum, total: int, active: bool, event: Callable[[str], None]) -> None:
        self.model, self.views, self.curriculum, self.total, self._event = model, views, curriculum, total, event
        cameras = views.camera[views.train]
        self.frames = {int(c): sorted(views.train[cameras == c], key=lambda i: views.time[i]) for c in np.unique(cameras)}
        self.step = 1 / max(len(curriculum.times) - 1, 1)  # of a frame, as a share of the capture
        several = curriculum.several and min(map(len, self.frames.values())) >= LOOKS and len(self.frames) >= MIN_CAMERAS
        self.active = active and several
        self._looked = 0

    def after_step(self, step: int, scale: float) -> None:
        """Look at the clocks if that is due after ``step`` steps, in pictures of the size that the model has learned from."""
        if not self.active or self._looked == len(AT) or step < AT[self._looked] * self.total or not self.curriculum.complete(step):
            return
        self._looked += 1
        known = self.views.clocks
        found = {camera: self._off(frames, scale) for camera, frames in self.frames.items()}
        off = {camera: known.get(camera, 0.0) / self.step + value for camera, (value, _) in found.items()}
        usual = float(np.median(list(off.values())))  # all clocks together can be shifted, and the motion with them
        clear = {c: float(np.clip(v - usual, -FARTHEST, FARTHEST)) for c, v in off.items()}
        clear = {c: v for c, v in clear.items() if abs(v) > max(LEAST, SURE * found[c][1])}
        if not clear and self._looked >= RIGHT_AFTER:
            self._looked = len(AT)
        if clear or known:
            self._use({camera: value * self.step for camera, value in clear.items()})
            told = ", ".join(f"camera {c} {abs(v):.2f} frames {'late' if v > 0 else 'early'}" for c, v in sorted(clear.items()))
            self._event(f"step {step}: clocks: {told or 'all are right'}")

    def state(self) -> dict[str, Any]:
        """JSON values for a checkpoint."""
        return {"clocks": [self._looked, sorted(self.views.clocks.items())]}

    def load(self, state: dict[str, Any]) -> None:
        """Inverse of `state`."""
        self._looked, clocks = state.get("clocks", [0, []])  # none in checkpoints of earlier versions
        self._use({int(camera): value for camera, value in clocks})

    def _use(self, clocks: dict[int, float]) -> None:
        self.views.clocks = self.model.clocks = clocks

    def _off(self, frames: list[int], scale: float) -> tuple[float, float]:
        """By how many frames the pictures of a camera are later than the model of their moments, and the standard error of that.

        Least squares of the pictures' differences from the model in what changes over time (Lucas and Kanade 1981, in time alone)."""
        chosen = np.unique(np.linspace(1, len(frames) - 2, max(FEWEST, min(LOOKS, TOGETHER // len(self.frames)))).round().astype(int))
        sums = np.array([self._look(int(frames[k]), scale) for k in chosen])
        along, square = sums.T
        total = square.sum()
        if total <= 0:  # nothing moves there
            return 0.0, float("inf")
        value = along.sum() / total
        error = np.sqrt(((along - value * square) ** 2).sum()) / total  # of frames that are independent of one another
        return float(value), float(error)

    def _look(self, i: int, scale: float) -> tuple[float, float]:
        """Sums over the pixels of frame ``i``: of the error times the change in a frame's time, and of that change squared."""
        at, half = self.views.moment(i), HALF * self.step
        ends = max(at - half, 0.0), min(at + half, 1.0)
        camera, kept = self.views.rasterizer_camera(i, scale), self.views.kept(i, scale)
        background = self.views.backdrop()
        with torch.no_grad():
            before, now, after = (self.model.render(camera, t, background).color for t in (ends[0], at, ends[1]))
            if (affine := self.model.affine) is not None:
                before, now, after = (affine(one, self.views.recorded_by(i)) for one in (before, now, after))
            change = (after - before) * (self.step / max(ends[1] - ends[0], 1e-9))
            error = self.views.target(i, scale).to(now.device) - now
            weight = 1 / (1 + (error / OUTLIER).square())
            if kept is not None:
                weight = weight * kept.to(now.device)[..., None]
            return float((weight * error * change).sum()), float((weight * change.square()).sum())
