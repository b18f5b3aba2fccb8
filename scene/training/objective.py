"""What one step minimises: the losses of Eq. 9 for one view, plus the priors."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from ...rasterizer import Frame, rasterize
from ..colour import CameraAffine, row_of
from ..losses.appearance import appearance_loss
from ..losses.depth_spread import BEGIN, EVERY, depth_spread, with_depth
from ..losses.held_depth import HeldDepth, held_depth_difference
from ..losses.measured_depth import MeasuredDepth
from ..losses.motion_terms import MeasuredFlow, MotionTerms
from ..losses.photometric import Recording
from ..losses.surface import surface_loss
from ..model import Model
from ..settings import TrainingSettings
from ..views import Views, Window
from .drawn_tiles import Drawn, DrawnTiles
from .optimiser import ALL_ROWS, Rows
from .recipe import Recipe
from .schedule import Phase
from .steps.dropout import keeps, thinned

WHOLE_EVERY = 8  # one step in so many uses the whole image where the others are cropped to the object
SMOOTH_END = 0.05  # of its weight that the smoothness of surfaces has at the end: it helps to find them, then blurs their detail
MOST_SHOWN = 0.8  # of the Gaussians; if a view may show more, selecting them costs more than it saves
DROPOUT_GROWS = 0.75  # of the training; then losses can be compared, to see whether training still improves
RELINK_EVERY = 100  # steps between two searches for the parts of the motion that carry each primitive


@dataclass(eq=False)
class Judged:
    """loss: what is minimised. image_loss: the part of it that compares images, detached. color, target [h, w, 3], of which color is as
    rendered, before the camera records it. weight [h, w]: of the pixels' gradients, 0 for those that do not count; None if it is 1
    everywhere. rows: copies of the Gaussians that the view may show, which get the gradients. gradients: parameters and their gradients, if
    these are known already."""

    loss: Tensor
    image_loss: Tensor
    color: Tensor
    target: Tensor
    weight: Tensor | None
    recording: Recording | None
    rows: Rows = ALL_ROWS
    gradients: Sequence[tuple[Tensor, Tensor]] | None = None

    def backward(self) -> None:
        """Leave the gradients of the loss with the parameters."""
        if self.gradients is None:
            # In this thread: for a GPU, autograd would otherwise wake another one and wait for it.
            with torch.autograd.set_multithreading_enabled(False):
                self.loss.backward()  # type: ignore[no-untyped-call]
        else:
            for parameter, gradient in self.gradients:
                parameter.grad = gradient

    def psnr(self) -> float:
        """PSNR in dB over the pixels that count, or over all if none does."""
        color = self.color.detach()
        if self.recording is not None:
            color = self.recording[0].detach() * color + self.recording[1].detach()
        error = (color - self.target).square().mean(-1)
        if self.weight is not None and bool(self.weight.any()):
            error = error[self.weight != 0]
        return -10 * float(np.log10(max(float(error.mean()), 1e-10)))


class Now(NamedTuple):
    """What changes from step to step: numbers, or tensors [] on the device while a step is captured as a CUDA graph. left_out: share of the
    Gaussians at rest that the step leaves out; smooth: weight of the smoothness of surfaces; both are None if they are 0. number: of the
    step, counted from the first one of the first stage."""

    left_out: float | Tensor | None
    smooth: float | Tensor | None
    number: int | Tensor


class Objective:
    """unit: the viewing distance, world units. several: whether one time alone shows the scene from several sides. total: number
    of steps; earlier: those that earlier stages took. measured_flow, measured_depth, held_depth: see `Trainer`."""

    def __init__(
        self,
        views: Views,
        settings: TrainingSettings,
        recipe: Recipe,
        unit: float,
        several: bool,
        total: int,
        earlier: int,
        measured_flow: MeasuredFlow | None,
        measured_depth: MeasuredDepth | None,
        held_depth: HeldDepth | None = None,
    ) -> None:
        self.views, self.settings, self.unit = views, settings, unit
        self.several, self.total, self.earlier = several, total, earlier
        self.measured_depth = measured_depth if settings.depth else None
        self.held_depth = held_depth if settings.moving_depth else None
        self.opacity = recipe.opacity if settings.opacity is None else settings.opacity
        self.spread = recipe.spread if settings.spread is None else settings.spread
        self.dropout = settings.dropout if several else 0.0
        self.drawn = DrawnTiles(views, settings.seed, earlier + total)
        self.motion_terms = MotionTerms(
            views,
            settings,
            unit,
            recipe.rest if settings.rest is None else settings.rest,
            recipe.inertia if settings.inertia is None else settings.inertia,
            recipe.interval if settings.interval is None else settings.interval,
            len(np.unique(views.time)),
            measured_flow,
        )

    def __call__(self, model: Model, i: int, step: int, phase: Phase, sh_degree: int) -> Judged:
        """Render ``model`` as training frame ``i`` with spherical harmonics up to ``sh_degree`` and judge it. ``step`` counts from 0."""
        views, s = self.views, self.settings
        window = None if step % WHOLE_EVERY == 0 else views.window(i, phase.scale)
        camera = views.rasterizer_camera(i, phase.scale, window)
        t, background = views.moment(i), views.backdrop()
        self.relink(model, step)
        drawn, now = self.drawn_of(i, phase.scale, step) if window is None else None, self.now(step)
        tiles = None if drawn is None else drawn.tiles
        whole = phase.move and self.motion_terms.flow_due(model, step, self.total)
        left_out = now.left_out
        fuller = 1 / (1 - left_out) if isinstance(left_out, float) else 1.0
        seen = model.in_view(t, camera, None if whole else tiles, phase.move, fuller)
        keep = None if left_out is None else keeps(model.gaussians.dynamic, left_out, s.seed, now.number)
        if seen is not None and keep is not None:
            seen, keep = seen[keep[seen]], None
        rows, faded = ALL_ROWS, None
        if seen is not None and (left_out is not None or len(seen) <= MOST_SHOWN * len(model.gaussians)):
            faded = model.opacities_at(t, phase.move)  # the penalty on opacity holds for all, in view or not
            model = model.with_gaussians(model.gaussians.select(seen))
            rows = Rows.of(model.gaussians, seen)
        gaussians, convexes = model.at(t, camera, phase.move, sh_degree)
        opacities = gaussians.opacities if faded is None else faded
        if left_out is not None:
            gaussians = thinned(gaussians, model.gaussians.dynamic, left_out, keep)
        spread = self.spread if step % EVERY == 0 and step > BEGIN * self.total else 0.0
        shapes = with_depth(camera, gaussians, convexes, self.unit) if spread else (gaussians, convexes)
        frame = rasterize(camera, *shapes, background, antialiased=model.antialiased, tiles=tiles)
        row = self.row(model.affine, i)
        recording = None if model.affine is None or row is None else model.affine.recorded_in(row)
        target = views.target(i, phase.scale, window)
        kept = views.kept(i, phase.scale, window)
        weight = None if drawn is None else drawn.pixels(target)
        if kept is not None:  # what the image shows where it does not count must not reach the pixels beside
            target = torch.where(kept[..., None], target, frame.color.detach())
            weight = kept.float() if weight is None else kept * weight
        alpha = views.alpha(i, phase.scale, window) if s.alpha and views.load_alpha is not None else None
        # Scaled as a mean over the whole image: there is nothing outside the window.
        share = target.shape[0] * target.shape[1] / (math.prod(views.size(phase.scale)))
        loss = appearance_loss(frame, target, s, views.background, alpha, kept, weight, recording, share)
        image_loss = loss.detach()
        if spread:
            loss = loss + EVERY * spread * share * depth_spread(frame.extras, frame.alpha, weight)
        loss = loss + self._surface(frame, target, i, now.smooth, weight, phase.scale, window)
        held = self.held(i, phase.scale, step, window)
        if held is not None:
            loss = loss + s.moving_depth * share * held_depth_difference(frame.depth, frame.alpha, held, self.unit, weight)
        loss = loss + self.opacity / (views.width * views.height) * (opacities.sum() + convexes.opacities.sum())
        if phase.move and model.field is not None:
            loss = loss + self.motion_terms(model, gaussians, i, phase.scale, step, self.total)
        return Judged(loss, image_loss, frame.color, target, weight, recording, rows)

    def relink(self, model: Model, step: int) -> None:
        """Have ``model`` search again for the parts of the motion that carry each primitive, if step ``step`` is one that does."""
        if step % RELINK_EVERY == 0:
            model.relink()

    def now(self, step: int) -> Now:
        """What is special about step ``step``."""
        return Now(self.left_out(step) or None, self.smooth(step) or None, self.earlier + step)

    def drawn_of(self, i: int, scale: float, step: int) -> Drawn | None:
        """What step ``step`` draws of frame ``i`` at ``scale``; None: everything."""
        return self.drawn.of(i, scale, step)

    def row(self, affine: CameraAffine | None, i: int) -> int | Tensor | None:
        """Row of ``affine`` in which frame ``i`` is recorded; None if there is none."""
        return row_of(affine, self.views, i)

    def measured(self, i: int, height: int, width: int) -> tuple[Tensor | None, Tensor | None]:
        """Measured depth of frame ``i``, and where something moves in front of it; see `MeasuredDepth`."""
        known = self.measured_depth
        return (None, None) if known is None else (known.of(i, height, width), known.moving(i))

    def held(self, i: int, scale: float, step: int, window: Window | None = None) -> Tensor | None:
        """The depth at which step ``step`` holds what moves in frame ``i`` at ``scale``, or in a ``window`` of it; see `HeldDepth.of`."""
        if self.held_depth is None:
            return None
        width, height = self.views.size(scale)
        whole = self.held_depth.of(i, height, width, step / max(self.total, 1))
        return whole if whole is None or window is None else whole[:, window[1] : window[3], window[0] : window[2]]

    def left_out(self, step: int) -> float:
        """Share of the Gaussians at rest that step ``step`` leaves out; 0 unless one time alone shows the scene from several sides."""
        progress = (self.earlier + step) / max(self.earlier + self.total, 1)
        return self.dropout * min(progress / DROPOUT_GROWS, 1.0)

    def smooth(self, step: int) -> float:
        """Weight of the smoothness of surfaces at ``step``; 0 unless one time alone shows the scene from several sides."""
        progress = (self.earlier + step) / max(self.earlier + self.total, 1)
        return self.settings.smooth * SMOOTH_END**progress if self.several else 0.0

    def _surface(
        self,
        frame: Frame,
        target: Tensor,
        i: int,
        smooth: float | Tensor | None,
        weight: Tensor | None,
        scale: float = 1.0,
        window: Window | None = None,
    ) -> Tensor:
        """The terms on the depth of ``frame``, a render of training frame ``i`` whose pixels' gradients have ``weight``. Like the other
        terms they are scaled as means over the whole image, of which ``frame`` may be a ``window``, at ``scale``."""
        height, width = frame.depth.shape
        measured, moving = self.measured(i, height, width) if window is None else self._measured_in(i, scale, window)
        if smooth is None and measured is None:
            return frame.depth.new_zeros(())
        whole_width, whole_height = (width, height) if window is None else self.views.size(scale)
        # `depth_smoothness` multiplies its mean by the width of what it gets.
        smooth = 0.0 if smooth is None else smooth * (height / whole_height)
        depth = self.settings.depth * (height * width / (whole_height * whole_width))
        return surface_loss(frame.depth, frame.alpha, target, self.unit, smooth, depth, measured, moving, weight)

    def _measured_in(self, i: int, scale: float, window: Window) -> tuple[Tensor | None, Tensor | None]:
        """`measured` in a ``window`` of the image at ``scale``. What moves has depth 0 there, where it is unknown."""
        if self.measured_depth is None:
            return None, None
        left, top, right, bottom = window
        width, height = self.views.size(scale)
        whole = self.measured_depth.static(i, height, width)
        return (None if whole is None else whole[top:bottom, left:right]), None
