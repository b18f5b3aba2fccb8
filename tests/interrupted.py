"""Small trainings with each kind of motion that die where a test says, with a checkpoint every 37 steps.

As a program it trains in a process of its own, which a real SIGKILL ends: interrupted.py KIND FOLDER THREADS [POINT STEP]
"""

import hashlib
import os
import signal
import sys
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import patch

import numpy as np
import torch
from e4dgs.scene.motion.lifetimes.lifetime import set_lifetime
from e4dgs.scene.motion.lifetimes.lifetimes import Lifetimes
from e4dgs.scene.motion.nodes.control_nodes import ControlNodes
from e4dgs.scene.motion.nodes.schedule import node_phases
from e4dgs.scene.motion.phases import coarse_phases, fine_phases
from e4dgs.scene.primitives import ConvexSet
from e4dgs.scene.training import trainer as module
from e4dgs.scene.training.trainer import Trainer
from sliding_gaussians import SETTINGS, fresh, make_views, wandering_views

STEPS, TIMES, SIZE, EVERY = 240, 3, 16, 37  # the checkpoints that matter are those at steps 185 and 222
ROUNDS = (200, 210, 220, 230)  # of density control
QUICK = SETTINGS.model_copy(
    update={
        "iterations": STEPS,
        "densify_every": 10,
        "densify_until": 0.96,
        "min_opacity": 0.08,
        "min_contribution": 0.05,
        "checkpoint_seconds": EVERY - 0.5,
    }
)
KINDS = ("planes", "nodes", "lifetimes", "fine")


class Killed(Exception):
    """In place of a SIGKILL, within one process."""


class Dying(Trainer):
    """Dies at ``dies``, a place and a step: `after` the step and its round of density control; `inside` the round, when the model has other
    primitives and the optimiser has not; while `saving`; when it has `saved`. ``rounds``: step, primitives before, and after."""

    dies: tuple[str, int] | None = None
    _within = False
    rounds: tuple = ()

    def __init__(self, *args, **options) -> None:
        super().__init__(*args, **options)
        self._plain_round, self.density.round = self.density.round, self._round  # type: ignore[method-assign]
        self._plain_replace, self.learned.replace = self.learned.replace, self._replace  # type: ignore[method-assign]

    def die(self) -> None:
        raise Killed

    def _at(self, place: str) -> None:
        if self.dies == (place, self.iteration):
            self.die()

    def _after_step(self, phase) -> None:
        super()._after_step(phase)
        self._at("after")

    def _round(self, step, phase, rigid_parts_alone=False) -> None:
        self._within, before = True, self._count()
        self._plain_round(step, phase, rigid_parts_alone)
        self._within = False
        self.rounds = (*self.rounds, (step, before, self._count()))

    def _count(self) -> tuple[int, int]:
        return len(self.model.gaussians), len(self.model.convexes)

    def _replace(self, new, source, step) -> None:
        if self._within and self.dies == ("inside", step):
            self.model.gaussians = new
            self.die()
        self._plain_replace(new, source, step)

    def _save(self) -> None:
        if self.dies == ("saving", self.iteration):
            with patch.object(os, "fsync", lambda handle: self.die()):  # the file is written, and not yet in its place
                super()._save()
        super()._save()
        self._at("saved")


class Dead(Dying):
    def die(self) -> None:
        os.kill(os.getpid(), signal.SIGKILL)


def prepared(kind: str, folder: Path | None, dies: tuple[str, int] | None = None, dying: type[Dying] = Dying) -> Dying:
    """A training of ``kind``, whose checkpoints lie in ``folder``."""
    views = wandering_views(9, SIZE) if kind == "nodes" else make_views(3, TIMES, SIZE)
    model = fresh(views, static=kind != "planes")
    gaussians = model.gaussians
    gaussians.dynamic[:] = True
    if kind == "planes":
        phases = coarse_phases("two-stage", STEPS, False, 0.5)
    elif kind == "nodes":
        model.motion = ControlNodes.over(gaussians.means.detach().numpy(), QUICK.seed)
        with torch.no_grad():
            gaussians.opacity_logits[:8] = -0.5  # nodes are spread again over what is opaque
        phases = node_phases(STEPS, 0.5)
    else:
        model.motion = Lifetimes(TIMES)
        set_lifetime(model.gaussians, torch.arange(len(gaussians)) % TIMES, 1.0)
        phases = coarse_phases("two-stage", STEPS, False, 0.5, from_rest=False)
    if kind == "fine":
        corners = gaussians.means.detach().numpy()[:8, None] + 0.15 * np.random.default_rng(0).normal(size=(8, 6, 3))
        model.convexes = ConvexSet.from_points(corners, np.full((8, 3), 0.4), 0, 0.3)
        set_lifetime(model.convexes, torch.ones(8), 1.0)
        with torch.no_grad():
            gaussians.opacity_logits[:50] = torch.linspace(-2.6, -1.2, 50)  # some of these fade during the rounds
        phases = fine_phases("alternating", 0, STEPS, static=False)
    recipe = model.motion.recipe
    trainer = dying(model, views, phases, QUICK, budget=90, grow=kind != "fine", recipe=recipe, checkpoints=folder)
    trainer.dies = dies
    return trainer


def run(trainer: Dying) -> Dying:
    """To its end, by a clock on which each step takes a second. torch's global generator begins in a state of its own for each
    place of death: nothing may come from it."""
    torch.manual_seed(trainer.dies[1] if trainer.dies else 0)
    with patch.object(module, "time", SimpleNamespace(monotonic=lambda: float(trainer.iteration))):
        trainer.run()
    return trainer


def digests(trainer: Dying) -> dict[str, str]:
    """Of every array of the model, and of the training's log but for what it says of the interruptions."""
    log = {name: value for name, value in vars(trainer.log).items() if name != "events"}
    log["events"] = [event for event in trainer.log.events if not event.startswith("continued from")]
    found = {"log": hashlib.sha256(repr(sorted(log.items())).encode()).hexdigest()}
    for name, array in trainer.model.to_arrays().items():
        found[name] = hashlib.sha256(repr((array.dtype, array.shape)).encode() + array.tobytes()).hexdigest()
    return found


if __name__ == "__main__":
    kind, folder, threads, *point = sys.argv[1:]
    torch.set_num_threads(int(threads))
    training = prepared(kind, Path(folder), (point[0], int(point[1])) if point else None, Dead)
    for name, digest in digests(run(training)).items():
        print(name, digest)
    print("continued", *(event for event in training.log.events if event.startswith("continued from")))
