"""The training loop: one view a step, density control, checkpoints, and a stop when the loss no longer improves."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from ..colour import CameraAffine, colour_recorders
from ..losses.term import NOTHING, Measured, Run
from ..model import Model
from ..motion.phases import Phase, alike_since
from ..motion.recipe import Recipe
from ..settings import TrainingSettings
from ..views import Views
from .checkpoint import FILE, load_checkpoint, save_checkpoint
from .control.clocks import ClockControl
from .control.density import Measure, keep_small, measure_responsibility
from .control.growth import DensityControl
from .control.learned_model import LearnedModel
from .control.motion import MotionControl
from .convergence import EVERY, SmoothedLoss, flat
from .curriculum import Curriculum
from .guard import NonFiniteGuard
from .log import TrainingLog
from .objective import Objective
from .replayed.objective import ReplayedObjective
from .replayed.padded_model import PaddedModel
from .replayed.responsibility import ReplayedResponsibility
from .steps.deferred import DeferredSteps
from .steps.immediate import ImmediateSteps, Step


class Trainer:
    """Trains ``model`` in place on ``views``.

    phases: run in this order. settings: see `TrainingSettings`. budget, most: see `DensityControl`. lr_scale: factor on the rates of
    parameters that an earlier stage has already trained. earlier: number of steps of that stage. measured: what renders are compared with
    beside the pictures. checkpoints: folder of this run; training continues from a state found there that has the same ``part``: the name
    of this training where a stage has several, one after another. advance: called with (steps, note). log: called with a line for people
    to read.
    """

    def __init__(
        self,
        model: Model,
        views: Views,
        phases: list[Phase],
        settings: TrainingSettings,
        budget: int,
        checkpoints: Path | None = None,
        part: str = "",
        lr_scale: float = 1.0,
        earlier: int = 0,
        grow: bool = True,
        measured: Measured = NOTHING,
        recipe: Recipe | None = None,
        advance: Callable[[int, str], None] = lambda n, note: None,
        log: Callable[[str], None] = lambda message: None,
        most: int | None = None,
    ) -> None:
        self.recipe = recipe = model.motion.recipe if recipe is None else recipe
        self.model, self.views, self.phases, self.settings = model, views, phases, settings
        self.checkpoints, self.part, self.grow, self.advance, self._say = checkpoints, part, grow, advance, log
        self.total = sum(phase.iterations for phase in phases)
        self.iteration = 0
        self._left_out = 0  # steps of phases that ended early
        self.log, self.guard, self.loss = TrainingLog(), NonFiniteGuard(), SmoothedLoss()
        moves = grow and not model.motion.static and any(phase.move for phase in phases)
        static_steps = sum(phase.iterations for phase in phases if not phase.move)
        opened = round(settings.open_until * self.total) if moves and recipe.opens else 0
        self.curriculum = Curriculum(views.train, views.time[views.train], settings.seed, static_steps, opened)
        if settings.affine and model.affine is None and (recorders := colour_recorders(views)) is not None:
            model.affine = CameraAffine(recorders).to(model.device)
        self._found = self._checkpoint()
        # Not of the model as given, if training goes on from a checkpoint: its unit may be that of what an earlier part left.
        found = None if self._found is None else self._found[1].get("unit")
        self.unit = views.viewing_distance(model.gaussians.means.detach().cpu().numpy()) if found is None else float(found)
        steps = self.curriculum.several, self.total, earlier
        self.objective = Objective(Run(views, settings, recipe, self.unit, *steps, measured))
        self.learned = LearnedModel(model, settings, self.unit, lr_scale)
        self.replayed: ReplayedObjective | None = None
        measure: Measure = measure_responsibility
        if model.device.type == "cuda" and torch.backends.cuda.is_built():
            memory = PaddedModel()
            self.replayed = ReplayedObjective(self.objective, lambda: self.learned.optimiser.parameters(), memory, self._event)
            measure = ReplayedResponsibility(views, memory, self._event)
        applies = DeferredSteps if model.device.type == "cuda" else ImmediateSteps
        self.steps = applies(self.learned, self.guard, self._applied)
        self.learned.before_change = self.steps.settle
        common = self.learned, views, self.curriculum, settings, recipe, phases
        self.motion = MotionControl(*common, self._event, log)
        self.clocks = ClockControl(model, views, self.curriculum, self.total, moves, self._event)
        self.density = DensityControl(*common, budget, grow, self._event, measure, measured.moving, most)

    def run(self) -> TrainingLog:
        """Run all phases, starting from a checkpoint if there is one."""
        self._resume()
        started, spent = time.monotonic(), self.log.seconds
        saved = started
        done = 0
        for phase in self.phases:
            for step in range(phase.iterations):
                if done + step < self.iteration + self._left_out:
                    continue
                now = self.motion.settling(phase, self.iteration)
                self._step(now, step)
                self.iteration += 1
                self.log.seconds = spent + time.monotonic() - started
                if self.iteration % 10 == 0 or self.iteration == self.total:
                    self.advance(10 if self.iteration % 10 == 0 else self.iteration % 10, self._note(phase))
                self._after_step(now)
                if self._converged():  # before saving, so that the checkpoint records it
                    self._leave_out(phase, phase.iterations - step - 1, last=done + phase.iterations == self.total)
                if self.checkpoints is not None and time.monotonic() - saved > self.settings.checkpoint_seconds:
                    self._save()
                    saved = time.monotonic()
            done += phase.iterations
        self.steps.settle()
        self.density.finish(self.iteration)
        self.log.iterations = self.iteration
        self.log.nonfinite_steps = self.guard.count
        return self.log

    def _step(self, phase: Phase, step: int) -> None:
        """Step ``step`` of ``phase``: render one view and update the parameters."""
        model = self.model
        i = self.curriculum.frame(self.iteration)
        objective = self.replayed or self.objective
        found = objective(model, i, self.iteration, phase, self._sh_degree())
        if self.iteration % 50 == 0:
            self.log.psnr.append([self.iteration, found.psnr()])
        found.backward()
        if self.motion.rigid_parts_alone:
            model.motion.leave_only_rigid_parts(model, self.learned.optimiser.parameters() | found.rows.named())
        now = Step(self.iteration, i, found.loss.detach(), found.image_loss)
        rejected = self.steps.apply(now, self.iteration / max(self.total, 1), self._frozen(phase, step), found.rows)
        if len(model.convexes) and self.recipe.largest_convex < math.inf:
            keep_small(model.convexes, self.recipe.largest_convex * self.unit, rejected)

    def _applied(self, step: Step, accepted: bool) -> None:
        """What `steps` report, on a GPU some steps later."""
        if accepted:
            self.loss.add(step.image_loss)
        else:
            self._event(f"step {step.number}: not finite, rolled back")
        if step.number % EVERY == 0:
            self.log.loss.append([step.number, self.loss.value()])

    def _sh_degree(self) -> int:
        """Colours start independent of direction; one degree is added after every sixth of the steps."""
        highest = self.model.sh_degree if self.settings.sh_degree is None else self.settings.sh_degree
        return min(highest, self.iteration * 6 // max(self.total, 1)) if self.grow else highest

    def _frozen(self, phase: Phase, step: int) -> frozenset[str]:
        """The kinds that do not train in this step, if they take turns."""
        if not phase.alternation or not len(self.model.convexes):
            return frozenset()
        turn = (step // phase.alternation) % 2
        return frozenset({"convexes"} if turn == 0 else {"gaussians", "motion"})

    def _after_step(self, phase: Phase) -> None:
        if self.iteration % 50 == 0:
            self.log.primitives.append([self.iteration, len(self.model.gaussians), len(self.model.convexes)])
        if phase.move and self.grow:
            self.motion.after_step(self.iteration, phase, self.log.skipped)
            self.clocks.after_step(self.iteration, phase.scale)
        self.density.after_step(self.iteration, phase, self.motion.rigid_parts_alone)

    def _converged(self) -> bool:
        """Whether the loss has stopped improving while no primitive was added or removed: each removal costs some loss, which the steps
        after it make up for."""
        progress = self.iteration / max(self.total, 1)
        if self.iteration % 100 or progress < max(0.5, self.density.grow_until):
            return False
        self.steps.settle()
        first = self.iteration - 2 * self.settings.patience
        if not self.curriculum.complete(first) or first < max(self.learned.changed, alike_since(self.phases, self.iteration)):
            return False
        return flat(self.log.loss, self.settings.patience)

    def _leave_out(self, phase: Phase, steps: int, last: bool) -> None:
        """Skip the rest of ``phase``, which has converged. Earlier losses say nothing about the next phase."""
        self._left_out, self.learned.changed = self._left_out + steps, self.iteration
        if last:
            self.log.stopped = f"converged after {self.iteration} of {self.total} steps"
            self._event(self.log.stopped)
        elif steps:
            self._event(f"step {self.iteration}: {phase.name} has converged, its last {steps} steps are left out")

    def _note(self, phase: Phase) -> str:
        return f"{phase.name}, loss {self.loss.value():.4f}, {len(self.model.gaussians)} Gaussians, {len(self.model.convexes)} convexes"

    def _event(self, message: str) -> None:
        self.log.events.append(message)
        self._say(message)

    def _save(self) -> None:
        assert self.checkpoints is not None
        self.steps.settle()
        state = {
            "iteration": self.iteration,
            "ema": self.loss.value(),
            **self.motion.state(),
            **self.clocks.state(),
            "changed": self.learned.changed,
            "left_out": self._left_out,
            "model": self.model.config,
            "nonfinite": self.guard.count,
            "part": self.part,
            "unit": self.unit,
            "log": vars(self.log),
        }
        save_checkpoint(self.checkpoints, self.learned.tensors(), state)

    def _checkpoint(self) -> tuple[dict[str, Tensor], dict[str, Any]] | None:
        """The state of this training from which it goes on, if there is one."""
        found = load_checkpoint(self.checkpoints) if self.checkpoints is not None else None
        if found is None and self.checkpoints is not None and (self.checkpoints / FILE).exists():
            self._event(f"the checkpoint {self.checkpoints / FILE} cannot be read, so training starts over")
        return found if found is not None and found[1].get("part", "") == self.part else None

    def _resume(self) -> None:
        if self._found is None:
            return
        (tensors, state), self._found = self._found, None
        self.learned.load(tensors, state)
        self.motion.load(state)
        self.clocks.load(state)
        self.loss.load(state["ema"])
        self.iteration, self.learned.changed, self._left_out = state["iteration"], state["changed"], state.get("left_out", 0)
        self.guard.count = state["nonfinite"]
        self.log = TrainingLog(**state["log"])
        self._event(f"continued from the checkpoint at step {self.iteration} of {self.total}")
        self.advance(self.iteration, "continued from a checkpoint")
