"""A loss term: what it needs to know of a step, how often it is due, and the scalar that it adds to the loss."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from typing import Any, ClassVar

import numpy as np
from torch import Tensor

from ...rasterizer import Camera, Convexes, Frame, Gaussians
from ..model import Model
from ..motion.times import Time
from ..settings import TrainingSettings
from ..views import Views, Window
from .held_depth import HeldDepth
from .measured_depth import MeasuredDepth
from .photometric import Recording


@dataclass(frozen=True, eq=False)
class Measured:
    """What the pictures showed before training. Each is None if nothing was measured.

    flow(i): the flow from frame i to the camera's next frame [H, W, 2] px and a weight [H, W], or None if there is none. depth: of the
    static scene. held: the depth of what moves. moving(i): the moving pixels of frame i [h, w] bool, or None if nothing moves in it."""

    flow: Callable[[int], tuple[Tensor, Tensor] | None] | None = None
    depth: MeasuredDepth | None = None
    held: HeldDepth | None = None
    moving: Callable[[int], Tensor | None] | None = None


NOTHING = Measured()


@dataclass(eq=False)
class Run:
    """One training, as its terms know it."""

    views: Views
    settings: TrainingSettings
    recipe: Any  # has the weights that the settings leave open, as attributes
    unit: float  # viewing distance, world units
    several: bool  # whether one time alone shows the scene from several sides
    total: int  # number of steps
    earlier: int = 0  # those that earlier stages took
    measured: Measured = NOTHING
    camera: Callable[..., Camera] = field(init=False)  # `Views.rasterizer_camera`, which keeps what it returns

    def __post_init__(self) -> None:
        self.times = len(np.unique(self.views.time))  # distinct ones
        self.dt = 1.0 / max(self.times - 1, 1)  # between two of them
        self.camera = cache(self.views.rasterizer_camera)

    def weight(self, name: str) -> float:
        """Weight ``name`` of the settings or, if they leave it open, of the recipe."""
        found = getattr(self.settings, f"{name}_weight")
        return float(getattr(self.recipe, name) if found is None else found)

    def progress(self, step: int) -> float:
        """Share of all steps, earlier stages included, that come before step ``step`` of this training."""
        return (self.earlier + step) / max(self.earlier + self.total, 1)


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
    """What a step has rendered, attached to autograd, and what it is compared with."""

    model: Model  # of its Gaussians, those that the view may show
    time: Time  # of the frame
    gaussians: Gaussians  # at that time
    convexes: Convexes
    opacities: Tensor  # [N] of all Gaussians at that time, in view or not
    frame: Frame  # [h, w]
    target: Tensor  # [h, w, 3] in [0, 1]: the picture; where pixels do not count, what was rendered
    kept: Tensor | None  # [h, w] bool: the pixels that count; None: all
    weight: Tensor | None  # [h, w]: factor on the gradient of each pixel; None: 1
    recording: Recording | None  # how the camera records colours
    size: tuple[int, int]  # width and height of the whole image in px, of which the frame may be a window
    share: float  # of the whole image's pixels that the frame has


class Term(ABC):
    """A term of the loss, made once for each training."""

    name: ClassVar[str]  # unique
    setting: ClassVar[str | None] = None  # name of its weight in the settings
    weight: float = 1.0  # that weight
    every: int = 1  # steps between two evaluations; what `value` returns is multiplied by it
    whole_image: ClassVar[bool] = False  # whether the term draws parts of the image that the step may leave out

    def __init__(self, run: Run) -> None:
        self.run = run
        if self.setting is not None:
            self.weight = run.weight(self.setting)

    def due(self, model: Model, now: Now) -> bool:
        """Whether step ``now``, one in `every`, has this term."""
        return self.weight > 0

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
        numbers are then tensors [] on the device, float32 or, for whole numbers, int64; and it must not wait for the device.
        """
