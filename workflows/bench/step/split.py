"""Measures where the time of our training step goes, with the motion that a capture gets: every part by name, and the remainder as "rest".

The functions that a step calls are wrapped. In the backward pass, hooks are on the nodes of the autograd graph, grouped by what they
compute: the image's loss, the image, what the motion has moved or the primitives; the others belong to regularisers.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import torch
from torch import Tensor
from torch.autograd.graph import Node

from ....scene.losses import appearance
from ....scene.model import Model
from ....scene.motion.carrier import Carrier
from ....scene.training import objective
from ....scene.training.trainer import Trainer
from ..rows import Bench, Check, Measured
from .clock import Clock
from .motions import is_rig, model_in_motion
from .training import PERIOD, make_trainer, views_of

FORWARD = ("data", "in view", "model forward", "motion forward", "rasterize forward", "loss forward", "regularisers forward")
BACKWARD = ("rasterize backward", "loss backward", "model backward", "motion backward", "regularisers backward", "gradients into leaves")
PARTS = (*FORWARD, *BACKWARD, "guard", "optimiser", "rest")
WHAT = {"nodes": "control nodes", "lifetimes": "lives of their own"}
WATCHING = "watching"  # setting and removing hooks, which is not part of a step


def measure(bench: Bench) -> Measured:
    views, masks, name = views_of(bench)
    motion = "lifetimes" if is_rig(views) else "nodes"
    trainer, run = make_trainer(model_in_motion(bench, views, masks, motion, 1.0), views)
    periods = max(2, bench.repeats)
    bench.expect(2 * periods + 1)

    def period(clock: Clock) -> float:
        start = time.perf_counter()
        with clock.part("rest"):
            run()
        return time.perf_counter() - start - clock.seconds[WATCHING]

    period(Clock())
    bench.tick("warm-up")
    plain, watched = [], []
    for _ in range(periods):
        plain.append(period(Clock()))
        bench.tick("as it is")
        clock = Clock(whole=("regularisers forward",))
        with watching(trainer, clock):
            watched.append((period(clock), clock.seconds))
        bench.tick("watched")
    seconds, taken = min(watched, key=lambda found: found[0])
    parts = {part: 1e3 * taken.get(part, 0.0) / PERIOD for part in PARTS}
    whole, unwatched = 1e3 * seconds / PERIOD, 1e3 * min(plain) / PERIOD
    return Measured(
        protocol=f"{name}, {len(trainer.model.gaussians):,} Gaussians on {WHAT[motion]}, {views.width}x{views.height}; the fastest of "
        f"{periods} runs of {PERIOD} steps; {torch.get_num_threads()} threads",
        checks=[
            Check("a step", unwatched, unit="ms"),
            Check("sum of the parts, of the whole step", 100 * sum(parts.values()) / whole, unit="%"),
            Check("step while it is watched, of one that is not", 100 * whole / unwatched, unit="%"),
        ],
        numbers={"parts_ms": parts, "whole_ms": whole, "unwatched_ms": unwatched},
        columns=("part", "ms", "share"),
        table=[(part, f"{ms:.2f}", f"{100 * ms / whole:.1f} %") for part, ms in parts.items()],
    )


@contextmanager
def watching(trainer: Trainer, clock: Clock) -> Iterator[None]:
    """Within this context, ``clock`` measures the parts of every step of ``trainer``."""
    model, seen, backward = trainer.model, _Seen(clock), Tensor.backward

    def watched_backward(loss: Tensor, *args: Any, **options: Any) -> None:
        with clock.part(WATCHING):
            handles = seen.watch(loss)
        backward(loss, *args, **options)
        with clock.part(WATCHING):
            for handle in handles:
                handle.remove()

    calls: list[tuple[Any, str, str, Callable[[Any], None] | None]] = [
        (objective, "rasterize", "rasterize forward", seen.rendered),
        (appearance, "appearance_loss", "loss forward", seen.judged),
        (trainer.objective, "inputs", "data", None),
        (Model, "in_view", "in view", None),
        (Model, "at", "model forward", seen.placed),
        (model.motion, "carry" if isinstance(model.motion, Carrier) else "alive", "motion forward", seen.moved),
        *((term, "value", "regularisers forward", None) for term in trainer.objective.terms[1:]),
        (trainer.learned.optimiser, "step", "optimiser", None),
        (trainer.guard, "accepts", "guard", None),
    ]
    kept = [(owner, name, vars(owner).get(name)) for owner, name, _, _ in calls]  # None: only the class has it, not the object
    for owner, name, part, after in calls:
        setattr(owner, name, clock.wrapped(getattr(owner, name), part, after))
    Tensor.backward = watched_backward  # type: ignore[assignment, method-assign]
    try:
        yield
    finally:
        Tensor.backward = backward  # type: ignore[method-assign]
        for owner, name, own in kept:
            delattr(owner, name) if own is None else setattr(owner, name, own)


class _Seen:
    """Keeps what a step computes on its way to the loss, to tell the nodes of its backward pass apart."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._image: list[Tensor] = []
        self._loss: list[Tensor] = []
        self._primitives: list[Tensor] = []
        self._moved: list[Tensor] = []

    def rendered(self, frame: Any) -> None:
        self._image = [frame.color]

    def judged(self, loss: Tensor) -> None:
        self._loss = [loss]

    def placed(self, kinds: Any) -> None:
        self._primitives = [value for kind in kinds for value in vars(kind).values() if isinstance(value, Tensor)]

    def moved(self, output: Any) -> None:
        self._moved = [value for value in output if value is not None]

    def watch(self, loss: Tensor) -> list[Any]:
        """Sets hooks on every node behind ``loss``. The time between nodes counts as rest."""
        left = _nodes_behind([loss])
        named = {"gradients into leaves": {node for node in left if "AccumulateGrad" in node.name()}}
        left -= named["gradients into leaves"]
        behind = {"motion": self._moved, "model": self._primitives, "rasterize": self._image, "loss": self._loss}
        for part, tensors in behind.items():  # earlier parts of the step lie behind all later ones, so they are assigned first
            named[f"{part} backward"] = left & _nodes_behind(tensors)
            left -= named[f"{part} backward"]
        named["regularisers backward"] = left
        return [handle for part, nodes in named.items() for handle in self._clock.watch(nodes, part)]


def _nodes_behind(tensors: list[Tensor]) -> set[Node]:
    """Nodes of the autograd graph that computed ``tensors``, directly or indirectly."""
    found: set[Node] = set()
    waiting = [t.grad_fn for t in tensors if t.grad_fn is not None]
    while waiting:
        node = waiting.pop()
        if node not in found:
            found.add(node)
            waiting += [following for following, _ in node.next_functions if following is not None]
    return found
