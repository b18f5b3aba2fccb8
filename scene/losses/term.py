"""A loss term: what it needs to know of a step, how often it is due, and the scalar that it adds to the loss."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
from torch import Tensor

from ...rasterizer import Camera, Convexes, Frame, Gaussians
from ..model import Model
from ..motion.interface import Time
from ..settings import TrainingSettings
from ..views import Kind, Views, Window
from .measured_depth import MeasuredDepth
from .photometric import Recording

MeasuredFlow = Callable[[int], tuple[Tensor, Tensor] | None]


@dataclass(eq=False)
class Run:
    """One training, as its terms know it.

    recipe: has the weights that ``settings`` leave open, as attributes of the same names. unit: the viewing distance, world units. several:
    whether one time alone shows the scene from several sides. total: number of steps; earlier: those that earlier stages took.
    measured_flow, measured_depth: see `Trainer`.
    """

    views: Views
    settings: TrainingSettings
    recipe: Any
    unit: float
    several: bool
    total: int
    earlier: int = 0
    measured_flow: MeasuredFlow | None = None
    measured_depth: MeasuredDepth | None = None
    _cameras: dict[tuple[int, float, Window | None], Camera] = field(default_factory=dict, repr=False)

    def __post_init__(self) -> None:
        self.times = len(np.unique(self.views.time))  # distinct ones
        self.dt = 1.0 / max(self.times - 1, 1)  # between two of them

    def weight(self, name: str) -> float:
        """Weight ``name`` of the settings or, if they leave it open, of the recipe."""
        found = getattr(self.settings, name)
        return float(getattr(self.recipe, name) if found is None else found)

    def progress(self, step: int) -> float:
        """Share of all steps, earlier stages included, that come before step ``step`` of this training."""
        return (self.earlier + step) / max(self.earlier + self.total, 1)

    def camera(self, i: int, scale: float, window: Window | None = None) -> Camera:
        """`Views.rasterizer_camera`, kept."""
        key = i, scale, window
        if key not in self._cameras:
            self._cameras[key] = self.views.rasterizer_camera(*key)
        return self._cameras[key]


@dataclass(frozen=True)
class Now:
    """Step ``number`` of a training, from 0. frame: index of the training frame that it sees, at image scale ``scale``, in ``window`` alone
    if there is one. move: whether primitives move in this phase."""

    frame: int
    number: int
    scale: float
    move: bool
    window: Window | None = None


@dataclass(frozen=True, eq=False)
class Rendered:
    """What a step has rendered, attached to autograd.

    model: of its Gaussians, those that the view may show. time: of the frame. gaussians, convexes: at that time. opacities [N]: of all
    Gaussians, in view or not. frame [h, w]. target [h, w, 3]: the picture, in [0, 1]; where pixels do not count, what was rendered. kept
    [h, w] bool: the pixels that count; None: all. weight [h, w]: factor on the gradient of each pixel; None: 1. recording: how the
    camera records colours. size: width and height of the whole image in px, of which the frame may be a window. share: of its pixels that
    the frame has.
    """

    model: Model
    camera: Camera
    time: Time
    gaussians: Gaussians
    convexes: Convexes
    opacities: Tensor
    frame: Frame
    target: Tensor
    kept: Tensor | None
    weight: Tensor | None
    recording: Recording | None
    size: tuple[int, int]
    share: float


class Term(ABC):
    """A term of the loss. It is made once for each training, with its weight from ``run``.

    name: unique. every: steps between two evaluations; what `value` returns is multiplied by it. whole_image: whether the term draws parts
    of the image that the step may leave out.
    """

    name: ClassVar[str]
    every: int = 1
    whole_image: ClassVar[bool] = False

    def __init__(self, run: Run) -> None:
        self.run = run

    def due(self, model: Model, now: Now) -> bool:
        """Whether step ``now``, one in `every`, has this term."""
        return True

    def inputs(self, model: Model, now: Now) -> Any:
        """All that `value` needs to know of the step: numbers, cameras, and tensors whose shapes do not change from step to step, as tuples
        of tuples; None where one has nothing. Returns None if the term has nothing to say about the frame."""
        return ()

    def shapes(self, camera: Camera, gaussians: Gaussians, convexes: Convexes) -> tuple[Gaussians, Convexes]:
        """What is drawn in place of ``gaussians`` and ``convexes``, to which extra channels may be added. One term of a step may do so."""
        return gaussians, convexes

    @abstractmethod
    def value(self, rendered: Rendered, inputs: Any) -> Tensor:
        """The weighted term, a scalar.

        On a GPU this is captured as a CUDA graph and replayed in other steps. So it must depend on the step by ``inputs`` alone, whose
        numbers are then tensors on the device, [] float32 or, for whole numbers, [1] int64; and must not wait for the device.
        """


def floats(picture: Tensor) -> Tensor:
    """A stored ``picture``, uint8, as float32 in [0, 1]."""
    return picture.float().div_(255.0)


def stored(views: Views, i: int, scale: float, kind: Kind, window: Window | None) -> Tensor:
    """The picture of frame ``i`` at ``scale``, cropped to ``window`` if there is one: uint8 [h, w, 3] or [h, w], on the device of
    ``views``."""
    picture = views.stored(i, scale, kind)
    if window is None:
        return picture
    left, top, right, bottom = window
    return picture[top:bottom, left:right]
