"""The kinds of motion: what the plan says of each, and which one moves a capture. Imports nothing heavy: a plan asks this, too."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

from ..settings import Strategy
from .nodes.schedule import first_motion_steps

if TYPE_CHECKING:
    from .interface import Motion

NODE_TIMES = 9  # least number of times for nodes; fewer say too little about motion
FORMER = {"free": "lifetimes"}  # names in models of earlier versions


@dataclass(frozen=True)
class MotionKind:
    """What is known of a kind of motion before anything runs.

    moves: what the plan says. load: returns its class. pixels: of a view for each Gaussian of the automatic budget, and steps:
    of the coarse stage, if they do not depend on the capture. first_steps: those that precede it, on very small images. step_seconds,
    megapixel_seconds: what a step takes on two cores, and in addition for each megapixel of the image, fitted to the captures in
    benchmarks/results. convexes: whether edges gain by
    convexes; else nothing is left to refine after the coarse stage.
    """

    moves: str
    load: Callable[[], type[Motion]]
    pixels: int | None = None
    steps: int | None = None
    first_steps: Callable[[Strategy, int], int] = lambda strategy, steps: 0
    step_seconds: float = 0.03
    megapixel_seconds: float = 0.145
    convexes: bool = True


def _static() -> type[Motion]:
    from .static import Static

    return Static


def _planes() -> type[Motion]:
    from .planes.field import DeformationField

    return DeformationField


def _nodes() -> type[Motion]:
    from .nodes.control_nodes import ControlNodes

    return ControlNodes


def _lifetimes() -> type[Motion]:
    from .lifetimes.lifetimes import Lifetimes

    return Lifetimes


KINDS: dict[str, MotionKind] = {
    "static": MotionKind("nothing moves: Gaussians at rest", _static, pixels=8, step_seconds=0.01, megapixel_seconds=0.3),
    "planes": MotionKind("Gaussians, moved by the six-plane field", _planes),
    "nodes": MotionKind(
        "Gaussians, moved by control nodes",
        _nodes,
        pixels=5,
        steps=32_000,
        first_steps=first_motion_steps,
        step_seconds=0.0105,
        megapixel_seconds=0.06,  # of the full image, although most steps render only a window around the object
        convexes=False,
    ),
    "lifetimes": MotionKind("Gaussians; those on moving pixels live around a time of their own", _lifetimes, step_seconds=0.02),
}


class Capture(Protocol):
    """What the choice depends on. static: nothing moves. cameras, frames, times: numbers of distinct ones. pairs: frames of which the same
    camera also saw the next time."""

    @property
    def static(self) -> bool: ...
    @property
    def cameras(self) -> int: ...
    @property
    def frames(self) -> int: ...
    @property
    def times(self) -> int: ...
    @property
    def pairs(self) -> int: ...


def choose(asked: str | None, capture: Capture, moving_seeds: bool | None = None) -> str:
    """The name of the kind of motion for ``capture``. asked: the setting, None or a name. moving_seeds: whether seeds were found on
    moving objects; None before that is known, when they are expected wherever masks can tell their depth.

    Nodes if each frame has its own camera: one view per time says too little for planes. Lifetimes if seeds lie on what moves. Planes for
    the others.
    """
    if capture.static:
        return "static"
    if asked is not None:
        return asked
    if capture.cameras == capture.frames and capture.pairs == 0 and capture.times >= NODE_TIMES:
        return "nodes"
    if moving_seeds is None:
        moving_seeds = capture.pairs > 0
    return "lifetimes" if moving_seeds else "planes"


def motion_class(kind: str) -> type[Motion]:
    """The class of the motions of ``kind``, by its present or an older name. Raises KeyError if there is no such kind."""
    return KINDS[FORMER.get(kind, kind)].load()
