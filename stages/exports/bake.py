"""Converts a model to Gaussians only, for tools that do not know convexes, and measures the loss."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch

from ...pipeline import SettingsError, StageError, counted
from ...pipeline.choice.evenly import evenly
from ...rasterizer import Frame, Gaussians, rasterize
from ...scene.convex_gaussians import GaussianFit
from ...scene.formats.ply import joined
from ...scene.metrics.psnr import decibels
from ...scene.model import Model
from ..shared.posed_frameset import PosedFrameSet
from .capture_cameras import camera_of, distinct_views
from .plain import PlainLook, compensated

SPREADS = (0.5, 0.6, 0.7, 0.8, 0.9, 1.0)  # standard deviations of a Gaussian over those of its convex's points; the fit begins at the best
LOOKS = 4  # views by which candidates are judged
MOMENTS = 5  # at which an export is compared with the model
STEPS = 200  # steps of the fit, each with another camera and time; a fit to the same 12 views over and over overfits to them
RATE = 0.04  # learning rate of Adam, decays to a twentieth; in ln of standard deviations, offsets in standard deviations, and logits


@dataclass
class Baked:
    """``model``, with its convexes replaced by Gaussians according to ``fit``. plain: what changes in its other Gaussians. antialiased:
    whether the result is for programs that compensate opacity."""

    model: Model
    fit: GaussianFit
    plain: PlainLook
    antialiased: bool = False

    def at(self, t: float) -> Gaussians:
        """The Gaussians, with SH, at time ``t`` in [0, 1], detached. Their number and order are the same at all times."""
        with torch.no_grad():
            gaussians, convexes = self.model.at(t)
            return joined(self.plain(gaussians), self.fit.gaussians(convexes))


@dataclass
class Loss:
    """psnr: dB, renders of the export against renders of the full model, over ``cameras`` cameras at each of ``times`` moments. convexes:
    how many became Gaussians. antialiased: the export is rendered as programs with compensated opacity do, otherwise as those in the
    classic mode do. worst: dB of the worst of several moments, at time ``when`` in [0, 1]."""

    psnr: float
    cameras: int
    convexes: int
    antialiased: bool = False
    times: int = 1
    worst: float = 0.0
    when: float = 0.0

    def __str__(self) -> str:
        mode = "antialiased (compensated opacity)" if self.antialiased else "classic (0.3 px² added)"
        said = f"{self.psnr:.1f} dB from the full model in {mode} viewers, {counted(self.cameras, 'camera')}"
        if self.times > 1:
            said += f" at {self.times} times, the worst {self.worst:.1f} dB at time {self.when:.3g}"
        return f"{counted(self.convexes, 'convex became a Gaussian', 'convexes became Gaussians')}: {said}" if self.convexes else said


def nothing_visible(what: str, moments: Sequence[float]) -> StageError:
    """The error of ``e4dgs export what`` if no primitive can be seen at any of ``moments``."""
    when = f"at time {moments[0]:g}" if len(moments) == 1 else f"at any of {len(moments)} times"
    return StageError(
        f"export {what}: nothing is visible {when}; look at other times (e4dgs view), and give one as --time, or train for longer"
    )


def bake(model: Model, frames: PosedFrameSet, antialiased: bool = False) -> Baked:
    """Replaces each convex by a Gaussian, with mean, covariance and opacity fitted so that renders from training cameras at all times are
    closest to those of the full ``model``.

    antialiased: for programs that compensate opacity (`compensated`); the model's own Gaussians stay as they were trained. Otherwise for
    those in the classic mode, and the Gaussians of an antialiased model are adjusted (`PlainLook`). Raises SettingsError if ``antialiased``
    is asked of a model that was trained in the classic mode."""
    if antialiased and not model.antialiased:
        raise SettingsError(
            "--antialiased: this model was trained in the classic mode (coarse.antialiased=false), so its Gaussians are not for such "
            "viewers; leave out --antialiased"
        )
    reference = model.convexes.points.detach()
    plain = PlainLook.unchanged(len(model.gaussians)) if antialiased else PlainLook.of(model, frames)
    if not len(model.convexes):
        return Baked(model, GaussianFit.uniform(reference, 1.0), plain, antialiased)
    few = evenly(frames.train, LOOKS)
    starts = [Baked(model, GaussianFit.uniform(reference, spread), plain, antialiased) for spread in SPREADS]
    best = starts[int(np.argmin([_error(start, frames, few) for start in starts]))]
    return min((best, replace(best, fit=_fitted(best, frames))), key=lambda baked: _error(baked, frames, few))


def _fitted(baked: Baked, frames: PosedFrameSet) -> GaussianFit:
    """The fit of ``baked`` after gradient descent on the squared difference of colour and alpha. The full model provides the ground truth
    from any camera at any time."""
    model, start = baked.model, baked.fit
    learned = {name: getattr(start, name).clone().requires_grad_() for name in ("log_spread", "offset", "opacity")}
    optimiser = torch.optim.Adam(list(learned.values()), lr=RATE)
    rng = np.random.default_rng(0)
    for step in range(STEPS):
        i, t = int(rng.choice(frames.train)), float(rng.uniform())
        wanted = _render(baked, None, frames, i, t)
        with torch.no_grad():
            gaussians, convexes = model.at(t)
        shown = joined(baked.plain(gaussians), replace(start, **learned).gaussians(convexes))
        seen = _render(baked, shown, frames, i, t)
        loss = (seen.color - wanted.color).square().mean() + (seen.alpha - wanted.alpha).square().mean()
        optimiser.param_groups[0]["lr"] = RATE * (1 - 0.95 * step / STEPS)
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
    return replace(start, **{name: value.detach() for name, value in learned.items()})


def loss_of(baked: Baked, frames: PosedFrameSet, *moments: float) -> Loss:
    """How far renders of ``baked`` are from those of its model, over held-out cameras if there are enough of them, at `MOMENTS` of the
    ``moments`` in [0, 1], evenly spread. Their mean squared error is the mean one; how well convexes and motion agree differs by time."""
    chosen = distinct_views(frames, np.concatenate([frames.test, frames.val]), LOOKS)
    if len(chosen) < LOOKS:
        chosen = distinct_views(frames, np.concatenate([frames.test, frames.val, frames.train]), LOOKS)
    looked = evenly(moments, MOMENTS)
    errors = [float(np.mean([_squared_error(baked, frames, int(i), t) for i in chosen])) for t in looked]
    mean, worst = (decibels(error) for error in (float(np.mean(errors)), max(errors)))
    when = looked[int(np.argmax(errors))]
    return Loss(mean, len(chosen), len(baked.model.convexes), baked.antialiased, len(looked), worst, when)


def _error(baked: Baked, frames: PosedFrameSet, chosen: np.ndarray) -> float:
    """Mean of `_squared_error` over the frames ``chosen``, at their own times."""
    times = [float(frames.time[i]) for i in chosen]
    return sum(_squared_error(baked, frames, int(i), t) for i, t in zip(chosen, times)) / len(chosen)


def _squared_error(baked: Baked, frames: PosedFrameSet, i: int, t: float) -> float:
    """Mean squared difference in [0, 1] between renders of ``baked`` and of its model from the camera of frame ``i`` at time ``t``."""
    with torch.no_grad():
        colors = [_render(baked, shown, frames, i, t).color.clamp(0, 1) for shown in (baked.at(t), None)]
    return float((colors[0] - colors[1]).square().mean())


def _render(baked: Baked, gaussians: Gaussians | None, frames: PosedFrameSet, i: int, t: float) -> Frame:
    """Renders ``gaussians`` as the programs do that ``baked`` is for, or if None the full model at time ``t``, from the camera of frame
    ``i`` on the model's background."""
    model = baked.model
    camera, background = camera_of(model, frames, i), torch.tensor(model.background)
    if gaussians is not None:
        return rasterize(camera, compensated(camera, gaussians) if baked.antialiased else gaussians, None, background)
    with torch.no_grad():
        return rasterize(camera, *model.at(t), background, antialiased=model.antialiased)
