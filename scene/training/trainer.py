"""The training loop: one view a step, the losses of Eq. 9, density control, checkpoints, and a stop when nothing improves any more."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ...rasterizer import rasterize
from ..colour import CameraAffine, colour_recorders
from ..losses.depth_smoothness import depth_smoothness
from ..losses.depth_spread import BEGIN, EVERY, depth_spread, with_depth
from ..losses.measured_depth import MeasuredDepth
from ..losses.motion_terms import MeasuredFlow, MotionTerms
from ..losses.photometric import photometric_loss
from ..model import Model
from ..primitives import ConvexSet, GaussianSet
from ..settings import TrainingSettings
from ..views import Views
from .checkpoint import load_checkpoint, restore, save_checkpoint
from .curriculum import Curriculum
from .density import choose_to_split, keep_small, measure_responsibility, split_along_longest_axis, survivors
from .dynamics import freeze_still_gaussians
from .guard import NonFiniteGuard
from .hidden import seen_share
from .log import TrainingLog
from .optimiser import RowAdam
from .rates import learning_rates
from .recipe import PLANES, Recipe
from .schedule import Phase, alike_since
from .turning import bodies_for_turning_parts, bound_to_bodies, leave_only_bodies

CONVERGED = 0.002  # relative improvement over `patience` steps below which a stage has converged
PROBE_VIEWS, FINAL_VIEWS = 16, 120  # whose error says where to grow; whose blending says what to remove at the end
DENSIFY_EVERY = 100
MOST_FOR_ONE = 4  # Gaussians at most, for each of the budget, which counts those that are there at a time
SMALL_SHARE = 0.6  # of the budget, on small images of a rig, whose cameras see more than one image holds
GAUSSIANS_PER_PIXEL = 0.6  # of the images in use: small images cannot tell more of them apart
# A new body's way is found on small images first, with all else at rest: steps on each size, at most this share of all steps.
SETTLE_SCALES, SETTLE_STEPS, SETTLE_SHARE = (0.125, 0.25, 0.5), 1000, 0.03
RELINK_EVERY = 100  # steps between two searches for what carries each primitive
SOLID = 0.2  # opacity of Gaussians over which the motion is spread
WHOLE_EVERY = 8  # steps of which one looks at the whole image where the others look at the object alone


class Trainer:
    """Trains ``model`` in place on ``views``.

    phases: what to do, in order. settings: see `TrainingSettings`. budget: most Gaussians. lr_scale: factor on the rates of what a stage
    before has already trained. measured_flow: for frame i the flow to its next frame [H, W, 2] px and a weight [H, W], or None where there
    is none. measured_depth: of what stands still. checkpoints: folder of this run; a state found there is continued. advance:
    called with (steps, note). log: a line for people.
    """

    def __init__(
        self,
        model: Model,
        views: Views,
        phases: list[Phase],
        settings: TrainingSettings,
        budget: int,
        checkpoints: Path | None = None,
        lr_scale: float = 1.0,
        grow: bool = True,
        measured_flow: MeasuredFlow | None = None,
        measured_depth: MeasuredDepth | None = None,
        recipe: Recipe = PLANES,
        advance: Callable[[int, str], None] = lambda n, note: None,
        log: Callable[[str], None] = lambda message: None,
    ) -> None:
        self.model, self.views, self.phases, self.settings = model, views, phases, settings
        self.budget, self.checkpoints, self.lr_scale, self.grow = budget, checkpoints, lr_scale, grow
        self.recipe, self.advance, self._say = recipe, advance, log
        self.total = sum(phase.iterations for phase in phases)
        self.log = TrainingLog()
        self.guard = NonFiniteGuard()
        self.iteration = 0
        moving = grow and model.field is not None and any(phase.move for phase in phases)
        still = sum(phase.iterations for phase in phases if not phase.move)
        times = views.time[views.train]
        opened = round(settings.open_until * self.total) if moving and recipe.opens else 0
        self.curriculum = Curriculum(views.train, times, settings.seed, still, opened)
        self.opacity = recipe.opacity if settings.opacity is None else settings.opacity
        self.spread = recipe.spread if settings.spread is None else settings.spread
        self.grow_until = recipe.grow_until if settings.densify_until is None else settings.densify_until
        self.densify_every = settings.densify_every or max(DENSIFY_EVERY, self.total // recipe.rounds)
        if settings.affine and model.affine is None and (recorders := colour_recorders(views)) is not None:
            model.affine = CameraAffine(recorders).to(model.device)
        self.unit = views.viewing_distance(model.gaussians.means.detach().cpu().numpy())
        self.measured_depth = measured_depth if settings.depth else None
        self.motion_terms = MotionTerms(
            views,
            settings,
            self.unit,
            recipe.still if settings.still is None else settings.still,
            recipe.inertia if settings.inertia is None else settings.inertia,
            len(np.unique(views.time)),
            measured_flow,
        )
        self.optimiser = self._make_optimiser()
        self._froze_still = False
        self._spread = 0  # times that the motion has been spread anew
        self._searched = 0  # times that parts that turn were looked for
        self._joined: int | None = None  # step at which the last body joined
        self._settles = False  # bodies alone learn
        self._left_out = 0  # steps of phases that ended early
        self._changed = 0  # step at which primitives or the motion last came or went
        self._ema = 0.0  # smoothed image loss, of all steps but those in `_losses`
        self._losses: dict[int, Tensor] = {}  # by step, still on the device: reading one waits for all that was asked of it before

    # -- set-up -------------------------------------------------------------------------------------------------------------------

    def _named(self) -> dict[str, Tensor]:
        named = {f"{s.KIND}.{name}": p for s in (self.model.gaussians, self.model.convexes) for name, p in s.parameters.items()}
        if self.model.field is not None:
            named |= {f"field.{name}": p for name, p in self.model.field.named_parameters()}
        if self.model.affine is not None:
            named |= {f"affine.{name}": p for name, p in self.model.affine.named_parameters()}
        return named

    def _make_optimiser(self) -> RowAdam:
        named = self._named()
        return RowAdam(named, learning_rates(named, self.settings, self.unit, self.lr_scale))

    # -- the loop -----------------------------------------------------------------------------------------------------------------

    def run(self) -> TrainingLog:
        """All phases, from a checkpoint where there is one."""
        self._resume()
        started, spent = time.monotonic(), self.log.seconds
        saved = started
        done = 0
        for phase in self.phases:
            for step in range(phase.iterations):
                if done + step < self.iteration + self._left_out:
                    continue
                now = self._settling(phase)
                self._step(now, step)
                self.iteration += 1
                self.log.seconds = spent + time.monotonic() - started
                if self.iteration % 10 == 0 or self.iteration == self.total:
                    self.advance(10 if self.iteration % 10 == 0 else self.iteration % 10, self._note(phase))
                self._after_step(now)
                if self._converged():  # before the checkpoint, which then says so
                    self._leave_out(phase, phase.iterations - step - 1, last=done + phase.iterations == self.total)
                if self.checkpoints is not None and time.monotonic() - saved > self.settings.checkpoint_seconds:
                    self._save()
                    saved = time.monotonic()
            done += phase.iterations
        if self.iteration < self._prune_step() or self._prune_step() >= self.total:
            self._prune_hardly_seen()
        self.log.iterations = self.iteration
        self.log.nonfinite_steps = self.guard.count
        return self.log

    def _step(self, phase: Phase, step: int) -> None:
        views, model, s = self.views, self.model, self.settings
        i = self.curriculum.frame(self.iteration)
        t = float(views.time[i])
        window = None if self.iteration % WHOLE_EVERY == 0 else views.window(i, phase.scale)
        camera = views.rasterizer_camera(i, phase.scale, window)
        highest = model.sh_degree if s.sh_degree is None else s.sh_degree
        degree = min(highest, self.iteration * 6 // max(self.total, 1)) if self.grow else highest
        background = torch.tensor(views.background)
        if self.iteration % RELINK_EVERY == 0:
            model.relink()
        gaussians, convexes = model.at(t, camera, phase.move, degree)
        spread = self.spread if self.iteration % EVERY == 0 and self.iteration > BEGIN * self.total else 0.0
        seen = with_depth(camera, gaussians, convexes, self.unit) if spread else (gaussians, convexes)
        frame = rasterize(camera, *seen, background)
        color = frame.color
        if model.affine is not None:
            color = model.affine(color, views.recorded_by(i))
        target = views.target(i, phase.scale, window)
        kept = views.kept(i, phase.scale, window)
        if kept is not None:  # what does not count is as it was drawn, and pulls at nothing
            target = torch.where(kept[..., None], target, color.detach())
        loss = photometric_loss(color, target, s.l1, s.ssim)
        if s.alpha and views.load_alpha is not None:
            wrong = (frame.alpha - views.alpha(i, phase.scale, window)).abs()
            loss = loss + s.alpha * (wrong if kept is None else wrong * kept).mean()
        # As if the whole image had been looked at: there is nothing outside of the window.
        share = target.shape[0] * target.shape[1] / (math.prod(views.size(phase.scale)))
        loss = loss * share
        if self.iteration % 50 == 0:
            mse = float((color.detach() - target).square().mean()) / (1.0 if kept is None else max(float(kept.float().mean()), 1e-6))
            self.log.psnr.append([self.iteration, -10 * float(np.log10(max(mse, 1e-10)))])
        image_loss = loss.detach()
        if spread:
            loss = loss + EVERY * spread * share * depth_spread(frame.extras, frame.alpha)
        if s.smooth and self.curriculum.several:
            loss = loss + s.smooth * depth_smoothness(frame.depth, frame.alpha, target, self.unit)
        if self.measured_depth is not None:
            loss = loss + s.depth * self.measured_depth.loss(frame.depth, frame.alpha, i)
        loss = loss + self.opacity / (views.width * views.height) * (gaussians.opacities.sum() + convexes.opacities.sum())
        if phase.move and model.field is not None:
            loss = loss + self.motion_terms(model, gaussians, i, phase.scale, self.iteration, self.total)
        loss.backward()
        parameters = self.optimiser.parameters()
        if self._settles:
            leave_only_bodies(model, parameters)
        if self.guard.accepts(loss.detach(), parameters, self.iteration, i):
            self.optimiser.step(self.iteration / max(self.total, 1), self._frozen(phase, step))
            if len(model.convexes) and self.recipe.largest_convex < math.inf:
                keep_small(model.convexes, self.recipe.largest_convex * self.unit)
        else:
            self.optimiser.zero_grad()
            self._event(f"step {self.iteration}: not finite, rolled back")
        self._losses[self.iteration] = image_loss
        if self.iteration % 20 == 0:
            self.log.loss.append([self.iteration, self._smoothed_loss()])

    def _smoothed_loss(self) -> float:
        """Of the images, over the steps so far."""
        if self._losses:
            for iteration, value in zip(self._losses, torch.stack(list(self._losses.values())).tolist()):
                self._ema = value if iteration == 0 else 0.98 * self._ema + 0.02 * value
            self._losses.clear()
        return self._ema

    def _frozen(self, phase: Phase, step: int) -> frozenset[str]:
        if not phase.alternation or not len(self.model.convexes):
            return frozenset()
        turn = (step // phase.alternation) % 2
        return frozenset({"convexes"} if turn == 0 else {"gaussians", "field"})

    # -- between steps ------------------------------------------------------------------------------------------------------------

    def _after_step(self, phase: Phase) -> None:
        progress = self.iteration / max(self.total, 1)
        if self.iteration % 50 == 0:
            self.log.primitives.append([self.iteration, len(self.model.gaussians), len(self.model.convexes)])
        if phase.move and self.grow:
            self._spread_motion(progress)
            if self._searched < len(self.recipe.bodies_at) and progress >= self.recipe.bodies_at[self._searched]:
                self._search_bodies(phase)
        due = progress >= self.recipe.freeze_at and self.curriculum.complete(self.iteration)
        if phase.move and self.grow and not self._froze_still and due:
            self._froze_still = True
            count = freeze_still_gaussians(self.model, self.views, self.recipe.freeze_pixels, self.recipe.freeze_share)
            self.log.skipped["still Gaussians taken out of the field"] = count
            self._event(f"step {self.iteration}: {count} of {len(self.model.gaussians)} Gaussians do not move and left the field")
        if self.grow and self.settings.hidden and self.iteration in {round(share * self.total) for share in self.recipe.hidden_at}:
            self._remove_hidden(phase)
        if self.iteration == self._prune_step() < self.total:
            self._prune_hardly_seen()
        if self.iteration % self.densify_every == 0 and self.iteration >= 200 and progress <= self.grow_until:
            self._control(phase)

    def _spread_motion(self, progress: float) -> None:
        """Where the recipe says so, over what is opaque by then."""
        model = self.model
        if model.field is None or self._spread >= len(self.recipe.spread_at) or progress < self.recipe.spread_at[self._spread]:
            return
        self._spread += 1
        solid = model.gaussians.opacities.detach() > SOLID
        renewed = model.field.spread_over(model.gaussians.means.detach()[solid].cpu().numpy()) if bool(solid.any()) else None
        if renewed is None:
            return
        self._renew(renewed)
        self._event(f"step {self.iteration}: the motion is spread anew")

    def _search_bodies(self, phase: Phase) -> None:
        """Parts that hold much of the error and turn too fast for gradients."""
        self._searched, model = self._searched + 1, self.model
        self._say("looking for parts that turn")
        error = measure_responsibility(model, self.views, self.curriculum.probe(self.iteration, 120), True, phase.scale).error_gaussians
        source = bodies_for_turning_parts(model, self.views, error, self.settings.seed, self._event)
        if source is not None and model.field is not None:
            self._renew(model.field)
            self._replace(model.gaussians, source)
            self._joined = self.iteration

    def _settling(self, phase: Phase) -> Phase:
        """``phase``, on smaller images while new bodies find their way."""
        each = max(1, min(SETTLE_STEPS, round(SETTLE_SHARE * self.total)))
        turn = (self.iteration - self._joined) // each if self._joined is not None else len(SETTLE_SCALES)
        self._settles = turn < len(SETTLE_SCALES)
        return replace(phase, scale=min(phase.scale, SETTLE_SCALES[turn])) if self._settles else phase

    def _renew(self, motion: Any) -> None:
        """Go on with another motion, some of whose parameters are those of the one before."""
        self._changed = self.iteration
        self.model.field = motion
        self.model.relink()
        known = self.optimiser.parameters()
        for name, parameter in motion.named_parameters():
            if known.get(f"field.{name}") is not parameter:
                self.optimiser.replace(f"field.{name}", parameter, torch.full((parameter.shape[0],), -1, device=parameter.device))

    def _control(self, phase: Phase) -> None:
        """What has faded is removed; Gaussians are added where the error is."""
        self._prune()
        if not self.grow:
            return
        model, progress = self.model, self.iteration / max(self.total, 1)
        measured = measure_responsibility(model, self.views, self.curriculum.probe(self.iteration, PROBE_VIEWS), phase.move, phase.scale)
        alive = round(float(measured.life_gaussians.sum()))  # what is not there at a time costs nothing then
        room = min(self._most(phase) - alive, MOST_FOR_ONE * self.budget - len(model.gaussians))
        if room <= 0:
            return
        error = torch.where(bound_to_bodies(model), measured.error_gaussians, 0.0) if self._settles else measured.error_gaussians
        rounds_left = max(1, round((self.grow_until - progress) * self.total / self.densify_every))
        wanted = room // rounds_left if self.recipe.steady else max(room // rounds_left, alive // 8)
        self._replace(*split_along_longest_axis(model.gaussians, choose_to_split(model.gaussians, error, min(room, wanted))))

    def _most(self, phase: Phase) -> int:
        """Gaussians that the images of ``phase`` bear."""
        if phase.scale == 1:
            return self.budget
        width, height = self.views.size(phase.scale)
        of_cameras = round(SMALL_SHARE * self.budget) if self.curriculum.several else 0
        return min(self.budget, max(round(GAUSSIANS_PER_PIXEL * width * height), of_cameras))

    def _prune(self, weights: tuple[Tensor | None, Tensor | None] = (None, None)) -> None:
        """Remove what is all but transparent and, where ``weights`` in px a view are known, what is hardly blended."""
        for primitives, weight in zip((self.model.gaussians, self.model.convexes), weights):
            keep = survivors(primitives, self.settings.min_opacity, weight, self.settings.min_weight)
            if len(keep) < len(primitives):
                self._replace(primitives.select(keep), keep)

    def _remove_hidden(self, phase: Phase) -> None:
        """What no view sees for what stands in front of it."""
        gaussians = self.model.gaussians
        seen = seen_share(self.model, self.views, self.curriculum.probe(self.iteration, FINAL_VIEWS), phase.move, phase.scale)
        keep = (seen >= self.settings.hidden).nonzero()[:, 0]
        self._event(f"step {self.iteration}: {len(gaussians) - len(keep)} of {len(gaussians)} Gaussians are hidden behind others and go")
        self._replace(gaussians.select(keep), keep)

    def _prune_step(self) -> int:
        return round(self.recipe.prune_at * self.total)

    def _prune_hardly_seen(self) -> None:
        """What the training views hardly blend is removed."""
        move = self.phases[-1].move if self.phases else False
        measured = measure_responsibility(self.model, self.views, self.curriculum.probe(self.total, FINAL_VIEWS), move, 0.5)
        before = len(self.model.gaussians), len(self.model.convexes)
        self._prune((measured.weight_gaussians, measured.weight_convexes))
        self._event(
            f"step {self.iteration}: removed, hardly blended by any training view: {before[0] - len(self.model.gaussians)} Gaussians, "
            f"{before[1] - len(self.model.convexes)} convexes"
        )

    def _replace(self, new: Any, source: Tensor) -> None:
        self._changed = self.iteration
        if isinstance(new, GaussianSet):
            self.model.gaussians = new
        else:
            assert isinstance(new, ConvexSet)
            self.model.convexes = new
        for name, parameter in new.parameters.items():
            self.optimiser.replace(f"{new.KIND}.{name}", parameter, source)

    def _converged(self) -> bool:
        """The smoothed loss of the last `patience` steps is no better than that of the `patience` steps before, and nothing came or went
        meanwhile: each removal costs some loss, which the steps after it make up for."""
        rows = self.settings.patience // 20
        progress = self.iteration / max(self.total, 1)
        if self.iteration % 100 or progress < max(0.5, self.grow_until) or len(self.log.loss) < 2 * rows:
            return False
        first = self.iteration - 2 * self.settings.patience
        if not self.curriculum.complete(first) or first < max(self._changed, alike_since(self.phases, self.iteration)):
            return False
        values = [value for _, value in self.log.loss]
        before, now = float(np.mean(values[-2 * rows : -rows])), float(np.mean(values[-rows:]))
        return now > before * (1 - CONVERGED)

    def _leave_out(self, phase: Phase, steps: int, last: bool) -> None:
        """The rest of ``phase``, which has converged. Losses of before say nothing of the next phase."""
        self._left_out, self._changed = self._left_out + steps, self.iteration
        if last:
            self.log.stopped = f"converged after {self.iteration} of {self.total} steps"
            self._event(self.log.stopped)
        elif steps:
            self._event(f"step {self.iteration}: {phase.name} has converged, its last {steps} steps are left out")

    def _note(self, phase: Phase) -> str:
        return f"{phase.name}, loss {self._smoothed_loss():.4f}, {len(self.model.gaussians)} Gaussians, {len(self.model.convexes)} convexes"

    def _event(self, message: str) -> None:
        self.log.events.append(message)
        self._say(message)

    # -- checkpoints --------------------------------------------------------------------------------------------------------------

    def _save(self) -> None:
        assert self.checkpoints is not None
        tensors = {f"parameter/{name}": p for name, p in self._named().items() if not name.startswith("field.")}
        tensors |= {f"optimiser/{name}": value for name, value in self.optimiser.state().items()}
        tensors |= {f"dynamic/{p.KIND}": p.dynamic for p in (self.model.gaussians, self.model.convexes)}
        if self.model.field is not None:
            tensors |= {f"motion/{name}": value for name, value in self.model.field.state_dict().items()}
            links = {p.KIND: self.model.links(p) for p in (self.model.gaussians, self.model.convexes) if len(p)}
            tensors |= {f"link/{kind}": link for kind, link in links.items() if link is not None}
        state = {
            "iteration": self.iteration,
            "ema": self._smoothed_loss(),
            "froze": self._froze_still,
            "motion": [self._spread, self._searched, self._joined],
            "changed": self._changed,
            "left_out": self._left_out,
            "model": self.model.config,
            "nonfinite": self.guard.count,
            "log": vars(self.log),
        }
        save_checkpoint(self.checkpoints, tensors, state)

    def _resume(self) -> None:
        found = load_checkpoint(self.checkpoints) if self.checkpoints is not None else None
        if found is None:
            return
        tensors, state = found
        restore(self.model, tensors, state)
        self.optimiser = self._make_optimiser()
        self.optimiser.load_state({k.removeprefix("optimiser/"): v for k, v in tensors.items() if k.startswith("optimiser/")})
        self.iteration, self._ema, self._froze_still = state["iteration"], state["ema"], state["froze"]
        self._spread, self._searched, self._joined = state["motion"]
        self._changed, self._left_out = state["changed"], state.get("left_out", 0)
        self.guard.count = state["nonfinite"]
        self.log = TrainingLog(**state["log"])
        self._event(f"continued from the checkpoint at step {self.iteration} of {self.total}")
        self.advance(self.iteration, "continued from a checkpoint")
