"""Measures what a step costs: a few real steps of the real trainer on the real views, at the sizes of the schedule's phases."""

from __future__ import annotations

import time
from collections.abc import Sequence

import torch

from ....scene.motion.phases import Phase
from ....scene.training.control.growth import FINAL_VIEWS, PROBE_VIEWS
from ....scene.training.control.splits import split
from ....scene.training.trainer import Trainer
from .costs import StepCosts, merged
from .growth import Growth
from .rehearse import Training

TOTAL, AT = 1000, 600  # steps of the training that is pretended, and the one from which steps are taken: every term of the loss is active
PERIOD = 8  # steps in which every term of the loss occurs as often as on average
WARM_UP = 2
PATIENCE = 4.0  # s; a measurement that has taken this long ends with the step


def measure_trainings(trainings: Sequence[Training], setup: float) -> list[StepCosts]:
    """The costs of trainings that a stage runs one after another on the same model, which is changed. setup: seconds that it took before
    the first."""
    return [measure_steps(one, setup if k == 0 else 0.0) for k, one in enumerate(trainings)]


def measure_steps(training: Training, setup: float = 0.0) -> StepCosts:
    """The costs of ``training``, whose model is changed. setup: seconds that the stage took before it."""
    clock = _Clock(training)
    total = max(sum(phase.iterations for phase in training.phases), 1)
    pieces = merged([(phase.iterations / total, phase.scale) for phase in training.phases])
    start, trainer = clock.count, clock.trainer
    measured, limits, loads, rounds = {}, {}, {}, 0.0
    for scale in sorted({scale for _, scale in pieces}):
        phase = Phase("measured", TOTAL, clock.move, scale)
        loads[scale] = clock.load(scale)
        measured[scale] = [(clock.count, clock.step(phase))]
        if trainer.grow:
            if not rounds:
                rounds = clock.round(phase) / max(measured[scale][0][1], 1e-6)
            limits[scale] = clock.limit(phase)
            if clock.fill(limits[scale]):
                measured[scale].append((clock.count, clock.step(phase)))
    recipe, settings = trainer.recipe, training.settings
    growth = Growth(
        start,
        limits,
        trainer.density.grow_until,
        recipe.rounds,
        recipe.steady,
        trainer.grow,
        settings.densify_every or 0,
        recipe.hidden_at if trainer.grow and settings.hidden else (),
    )
    seen, grows = min(FINAL_VIEWS, len(training.views.train)), trainer.grow
    searches = len(recipe.rigid_parts_at) if grows and clock.move else 0
    return StepCosts(
        pieces,
        {scale: tuple(rows) for scale, rows in measured.items()},
        growth,
        rounds or StepCosts.round,
        ((seen, False),) * (1 + searches) + ((seen, True),) * len(growth.hidden_at),
        loads,
        len(training.views.train),
        setup,
    )


class _Clock:
    """Takes single steps of a training, and says how long they take."""

    def __init__(self, training: Training) -> None:
        self.training, options = training, dict(training.options)
        options.pop("part", None)
        self.move = any(phase.move for phase in training.phases)
        phase = Phase("measured", TOTAL, self.move)
        self.trainer = Trainer(training.model, training.views, [phase], training.settings, **options)
        self.frames = [self.trainer.curriculum.frame(AT + k) for k in range(PERIOD)]
        self.waits = training.model.device.type == "cuda"  # whether work goes on behind the host, which records it at first
        self.alive = 1.0  # mean share of the times at which a Gaussian is present

    @property
    def count(self) -> int:
        """Number of Gaussians now."""
        return len(self.trainer.model.gaussians)

    def load(self, scale: float) -> float:
        """Mean seconds to load a picture of ``scale``."""
        begin = self._now()
        for i in self.frames:
            self.training.views.target(i, scale)
        return (self._now() - begin) / len(self.frames)

    def step(self, phase: Phase) -> float:
        """Mean seconds of a step, over a period of them."""
        self._take(phase, PERIOD if self.waits else WARM_UP)
        begin = self._now()
        taken = self._take(phase, PERIOD, begin)
        return (self._now() - begin) / taken

    def round(self, phase: Phase) -> float:
        """Seconds of a round of density control."""
        trainer = self.trainer
        probed = trainer.curriculum.probe(AT, PROBE_VIEWS)
        if self.waits:
            trainer.density._measure(trainer.model, trainer.views, probed, phase.move, phase.scale)
        begin = self._now()
        found = trainer.density._measure(trainer.model, trainer.views, probed, phase.move, phase.scale)
        seconds = self._now() - begin
        self.alive = max(float(found.life_gaussians.mean()), 1e-3) if self.count else 1.0
        return seconds

    def limit(self, phase: Phase) -> int:
        """The number of Gaussians that the images of ``phase`` allow, of which those present at one time count."""
        density = self.trainer.density
        most = round(density._most(phase) / self.alive)
        return max(self.count, min(most, density.most))

    def fill(self, count: int) -> bool:
        """Splits Gaussians at random until there are ``count``. Returns whether that made a difference."""
        learned, before = self.trainer.learned, self.count
        generator = torch.Generator().manual_seed(0)
        while 0 < self.count < count:
            chosen = torch.randperm(self.count, generator=generator)[: count - self.count].sort().values
            learned.replace(*split(learned.model.gaussians, chosen.to(learned.model.gaussians.device)), AT)
        return self.count > 1.1 * before

    def _take(self, phase: Phase, count: int, begin: float | None = None) -> int:
        for k in range(count):
            self.trainer.iteration = AT + k
            self.trainer._step(phase, AT + k)
            if begin is not None and time.perf_counter() - begin > PATIENCE:
                return k + 1
        return count

    def _now(self) -> float:
        self.trainer.steps.settle()
        if self.waits:
            torch.cuda.synchronize()
        return time.perf_counter()
