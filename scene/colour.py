"""Real cameras disagree about colour: a learned gain and offset per channel and camera (or photo), around a fixed mean."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import torch
from torch import Tensor, nn

from .views import Views


class CameraAffine(nn.Module):
    """Gain and offset, [cameras, 3] each. Over the training cameras the gains multiply to one and the offsets add up to zero, so the
    model's own colours stay those of the mean camera. Held-out cameras are rendered as the mean camera.

    cameras: numbers of the training cameras, in the order of the rows; numbers of the photos if each photo has its own exposure.
    """

    def __init__(self, cameras: Iterable[int]) -> None:
        super().__init__()
        self.cameras = [int(c) for c in cameras]
        self._row = {camera: row for row, camera in enumerate(self.cameras)}
        self.log_gain = nn.Parameter(torch.zeros(len(self.cameras), 3))
        self.offset = nn.Parameter(torch.zeros(len(self.cameras), 3))

    def forward(self, image: Tensor, camera: int) -> Tensor:
        """``image`` [H, W, 3] as camera number ``camera`` would record it. A camera without a row is treated as the mean camera."""
        recording = self.recording(camera)
        return image if recording is None else image * recording[0] + recording[1]

    def recording(self, camera: int) -> tuple[Tensor, Tensor] | None:
        """The gain and the offset [3] of camera number ``camera``; None if it has no row."""
        row = self.row(camera)
        return None if row is None else self.recorded_in(row)

    def row(self, camera: int) -> int | None:
        """Which row is that of camera number ``camera``; None if there is none."""
        return self._row.get(int(camera))

    def recorded_in(self, row: int | Tensor) -> tuple[Tensor, Tensor]:
        """The gain and the offset [3] in row ``row``, a number or a tensor [1] on the module's device."""
        gain, offset = self.log_gain[row].reshape(3), self.offset[row].reshape(3)
        return torch.exp(gain - self.log_gain.mean(0)), offset - self.offset.mean(0)


def colour_recorders(views: Views) -> np.ndarray | None:
    """Sorted numbers of the cameras (or photos) that recorded the training frames and may disagree about colour. None if there is only one,
    or if nearly every frame has a camera number of its own, as in rendered captures."""
    if views.recorder is not None:
        recorders = np.unique(views.recorder[views.train])
        return recorders if len(recorders) > 1 else None
    cameras = np.unique(views.camera[views.train])
    return cameras if len(cameras) > 1 and len(views.train) > 1.5 * len(cameras) else None
