"""Where the time of our training step goes: every part of it by name, and what is left as "rest".

Parts are measured by wrapping the functions that a step calls; of the backward pass, by hooks on the nodes of the autograd graph, which are
told apart by what they lead to: the image's loss, the image, the field's output, the primitives; the others are regularisers'.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import torch
from torch import Tensor
from torch.utils.hooks import RemovableHandle

from ....scene.motion.interface import Displacement
from ....scene.training import objective
from ....scene.training.trainer import Trainer
from ..rows import Bench, Check, Measured
from .clock import Clock, nodes_behind
from .training import PERIOD, make_model, make_trainer, views_of

PARTS = (
    "data",
    "model forward",
    "field forward",
    "rasterize forward",
    "loss forward",
    "regularisers forward",
    "rasterize backward",
    "loss backward",
    "model backward",
    "field backward",
    "regularisers backward",
    "gradients into leaves",
    "guard",
    "optimiser",
    "rest",
)
WATCHING = "watching"  # setting hooks and taking them away: no part of a step


def measure(bench: Bench) -> Measured:
    views, masks, name = views_of(bench)
    trainer, step = make_trainer(make_model(bench, views, masks), views)
    periods = max(2, bench.repeats)
    bench.expect(2 * periods + 1)
    for _ in range(PERIOD):
        step()
    bench.tick("warm-up")
    plain, taken, wholes = [], [], []
    for _ in range(periods):
        start = time.perf_counter()
        for _ in range(PERIOD):
            step()
        plain.append(time.perf_counter() - start)
        bench.tick("as it is")
        clock = Clock()
        start = time.perf_counter()
        with watched(trainer, clock):
            for _ in range(PERIOD):
                with clock.part("rest"):
                    step()
        wholes.append(time.perf_counter() - start - clock.seconds[WATCHING])
        taken.append(clock.seconds)
        bench.tick("watched")
    best = min(range(periods), key=wholes.__getitem__)
    parts = {part: 1e3 * taken[best].get(part, 0.0) / PERIOD for part in PARTS}
    whole, unwatched = 1e3 * wholes[best] / PERIOD, 1e3 * min(plain) / PERIOD
    return Measured(
        protocol=f"{name}, {len(trainer.model.gaussians):,} Gaussians, {views.width}x{views.height}; the fastest of {periods} runs of "
        f"{PERIOD} steps; {torch.get_num_threads()} threads",
        checks=[
            Check("sum of the parts, of the whole step", 100 * sum(parts.values()) / whole, unit="%"),
            Check("step while it is watched, of one that is not", 100 * whole / unwatched, unit="%", note=f"{unwatched:.1f} ms unwatched"),
        ],
        numbers={"parts_ms": parts, "whole_ms": whole, "unwatched_ms": unwatched},
        columns=("part", "ms", "share"),
        table=[(part, f"{ms:.2f}", f"{100 * ms / whole:.1f} %") for part, ms in parts.items()],
    )


@contextmanager
def watched(trainer: Trainer, clock: Clock) -> Iterator[None]:
    """While it lasts, every step of ``trainer`` is taken apart by ``clock``."""
    model, views = trainer.model, trainer.views
    field = model.field
    assert field is not None
    graph = _Graph(clock)
    before = field.register_forward_pre_hook(lambda module, inputs: clock.enter("field forward"))

    def moved(module: Any, inputs: Any, output: Displacement) -> None:
        clock.leave()
        graph.moved(output)

    after = field.register_forward_hook(moved)
    kept_rasterize, kept_loss, kept_backward = objective.rasterize, objective.photometric_loss, Tensor.backward
    kept_terms, kept_step, kept_accepts = trainer.objective.motion_terms, trainer.learned.optimiser.step, trainer.guard.accepts
    objective.rasterize = clock.wrapped(kept_rasterize, "rasterize forward", graph.rendered)
    objective.photometric_loss = clock.wrapped(kept_loss, "loss forward", graph.judged)
    views.target = clock.wrapped(views.target, "data")  # type: ignore[method-assign]
    views.rasterizer_camera = clock.wrapped(views.rasterizer_camera, "data")  # type: ignore[method-assign]
    model.at = clock.wrapped(model.at, "model forward", graph.placed)  # type: ignore[method-assign]
    trainer.objective.motion_terms = clock.wrapped(_flat(kept_terms, clock, graph), "regularisers forward")  # type: ignore[assignment]
    trainer.learned.optimiser.step = clock.wrapped(kept_step, "optimiser")  # type: ignore[method-assign]
    trainer.guard.accepts = clock.wrapped(kept_accepts, "guard")  # type: ignore[method-assign]

    def backward(loss: Tensor, *args: Any, **options: Any) -> None:
        with clock.part(WATCHING):
            handles = graph.watch(loss)
        kept_backward(loss, *args, **options)
        with clock.part(WATCHING):
            for handle in handles:
                handle.remove()

    Tensor.backward = backward  # type: ignore[assignment, method-assign]
    try:
        yield
    finally:
        Tensor.backward = kept_backward  # type: ignore[method-assign]
        objective.rasterize, objective.photometric_loss = kept_rasterize, kept_loss
        trainer.objective.motion_terms = kept_terms
        for owner, name in ((views, "target"), (views, "rasterizer_camera"), (model, "at")):
            delattr(owner, name)  # the wrapper on the object; the class has its own
        del trainer.learned.optimiser.step, trainer.guard.accepts
        before.remove()
        after.remove()


def _flat(terms: Any, clock: Clock, graph: _Graph) -> Any:
    """The regularisers, with whatever of the model they call counted as theirs."""

    def call(*args: Any) -> Tensor:
        with clock_as(clock, "regularisers forward"):
            graph.paused = True
            try:
                return terms(*args)
            finally:
                graph.paused = False

    return call


@contextmanager
def clock_as(clock: Clock, part: str) -> Iterator[None]:
    """While it lasts, every part that is entered counts as ``part``."""
    enter = clock.enter
    clock.enter = lambda part_inside: enter(part)  # type: ignore[method-assign, assignment, misc]
    try:
        yield
    finally:
        del clock.enter


class _Graph:
    """What a step computed on its way to the loss, so that the nodes of its backward pass can be told apart."""

    def __init__(self, clock: Clock) -> None:
        self.clock, self.paused = clock, False
        self.field: list[Tensor] = []
        self.primitives: list[Tensor] = []
        self.image: list[Tensor] = []
        self.loss: list[Tensor] = []

    def moved(self, output: Displacement) -> None:
        if not self.paused:
            self.field = list(output)

    def placed(self, kinds: tuple[Any, Any]) -> None:
        if not self.paused:
            self.primitives = [value for kind in kinds for value in vars(kind).values() if isinstance(value, Tensor)]

    def rendered(self, frame: Any) -> None:
        self.image = [frame.color]

    def judged(self, loss: Tensor) -> None:
        self.loss = [loss]

    def watch(self, loss: Tensor) -> list[RemovableHandle]:
        """Hooks on every node behind ``loss``. The time between nodes stays with the rest."""
        everything = nodes_behind([loss])
        leaves = {node for node in everything if "AccumulateGrad" in node.name()}
        field = nodes_behind(self.field, leaves)
        model = nodes_behind(self.primitives, leaves | field)
        image = nodes_behind(self.image, leaves | field | model)
        judged = nodes_behind(self.loss, leaves | field | model | image)
        named = {
            "gradients into leaves": leaves,
            "field backward": field,
            "model backward": model,
            "rasterize backward": image,
            "loss backward": judged,
            "regularisers backward": everything - leaves - field - model - image - judged,
        }
        return [handle for part, nodes in named.items() for handle in self.clock.watch(nodes, part)]
