"""All that a training step reads besides the model and the settings: one frame, and what the terms of the loss ask for.

Inputs are trees: tuples of tensors, numbers and cameras, which change from step to step, and of None, text and frozen dataclasses, which
steps of one kind have in common. A CUDA graph reads them from buffers of the same structure.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

from torch import Tensor

from ....rasterizer import Camera
from ...colour import CameraAffine, row_of
from ...losses.term import stored
from ...motion.interface import Time
from ...views import Views, Window

Index = int | Tensor  # a whole number; on the device: int64 [1]


@dataclass(frozen=True)
class Fixed:
    """move: whether primitives move. sh_degree: highest degree of spherical harmonics. size: width and height of the whole image in px.
    whole: whether parts are drawn of which `StepInputs.drawn` says that they are left out."""

    move: bool
    sh_degree: int
    size: tuple[int, int]
    whole: bool = False


class FrameInputs(NamedTuple):
    """camera: of the picture. time: in [0, 1]. background [3]. picture [h, w, 3] and kept [h, w] uint8, see `Views`. recorder: row of
    `CameraAffine`; None if there is none."""

    camera: Camera
    time: Time
    background: Tensor
    picture: Tensor
    kept: Tensor | None
    recorder: Index | None


class StepInputs(NamedTuple):
    """drawn [rows, columns] float32: `Drawn.weight`; None: everything is drawn. left_out: share of the Gaussians at rest that the step
    leaves out, and its number among all steps; None: none. terms: name and `Term.inputs` of those that are due."""

    fixed: Fixed
    frame: FrameInputs
    drawn: Tensor | None
    left_out: tuple[float | Tensor, Index] | None
    terms: tuple[tuple[str, Any], ...]


def frame_inputs(
    views: Views, camera: Camera, affine: CameraAffine | None, i: int, scale: float, window: Window | None = None
) -> FrameInputs:
    """Frame ``i`` at image scale ``scale``, cropped to ``window`` if there is one; ``camera``: the one for that."""
    picture = stored(views, i, scale, "colour", window)
    kept = None if views.load_kept is None else stored(views, i, scale, "kept", window)
    return FrameInputs(camera, views.moment(i), views.backdrop(), picture, kept, row_of(affine, views, i))
