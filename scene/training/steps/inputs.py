"""All that a training step reads besides the model and the settings: one frame, and what the terms of the loss ask for.

Inputs are trees: tuples of tensors, numbers and cameras, which change from step to step, and of None, text and frozen dataclasses, which
steps of one kind have in common. A CUDA graph reads them from buffers of the same structure.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

from torch import Tensor

from ....rasterizer import Camera
from ...colour import CameraAffine
from ...losses.photometric import Recording
from ...motion.interface import Time
from ...views import Views, Window
from ..drawn_tiles import Drawn

Whole = int | Tensor  # a whole number; on the device: int64 []


@dataclass(frozen=True)
class Fixed:
    """What steps of one kind have in common besides the structure of their inputs."""

    move: bool  # whether primitives move
    sh_degree: int  # highest degree of spherical harmonics
    size: tuple[int, int]  # width and height of the whole image, px
    whole: bool = False  # whether parts are drawn that `StepInputs.drawn` leaves out


class FrameInputs(NamedTuple):
    """What a render of one frame is compared with."""

    camera: Camera  # of the picture
    time: Time  # in [0, 1]
    background: Tensor  # [3]
    picture: Tensor  # [h, w, 3] uint8
    kept: Tensor | None  # [h, w] uint8, see `Views`
    recorder: Whole | None  # row of `CameraAffine`

    def recording(self, affine: CameraAffine | None) -> Recording | None:
        """How the camera records colours."""
        if affine is None or self.recorder is None:
            return None
        # Not by a tensor [], whose value the host would wait for.
        return affine.recorded_in(self.recorder.view(1) if isinstance(self.recorder, Tensor) else self.recorder)


class StepInputs(NamedTuple):
    fixed: Fixed
    frame: FrameInputs
    drawn: Drawn | None  # None: everything
    left_out: tuple[float | Tensor, Whole] | None  # share of the Gaussians at rest that the step leaves out, and its number among all steps
    terms: tuple[tuple[str, Any], ...]  # name and `Term.inputs` of those that are due


def frame_inputs(
    views: Views, camera: Camera, affine: CameraAffine | None, i: int, scale: float, window: Window | None = None
) -> FrameInputs:
    """Frame ``i`` at image scale ``scale``, cropped to ``window`` if there is one; ``camera``: the one for that."""
    picture = views.stored(i, scale, "colour", window)
    kept = None if views.load_kept is None else views.stored(i, scale, "kept", window)
    recorder = None if affine is None else affine.row(views.recorded_by(i))
    return FrameInputs(camera, views.moment(i), views.backdrop(), picture, kept, recorder)
