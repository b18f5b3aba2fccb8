"""Real cameras disagree about colour: one affine a channel and camera, or a photo, learned against a fixed mean."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import torch
from torch import Tensor, nn

from .views import Views


class CameraAffine(nn.Module):
    """Gain and offset [cameras, 3] each. Over the training cameras gains multiply to one and offsets add to zero, so that the model's
    own colours stay those of the mean camera, which is what held-out cameras are rendered with.

    cameras: the numbers of the training cameras (of the photos, where each has an exposure of its own), in the order of the rows.
    """

    def __init__(self, cameras: Iterable[int]) -> None:
        super().__init__()
        self.cameras = [int(c) for c in cameras]
        self._row = {camera: row for row, camera in enumerate(self.cameras)}
        self.log_gain = nn.Parameter(torch.zeros(len(self.cameras), 3))
        self.offset = nn.Parameter(torch.zeros(len(self.cameras), 3))

    def forward(self, image: Tensor, camera: int) -> Tensor:
        """``image`` [H, W, 3] as the camera of number ``camera`` would record it; one without a row is the mean camera."""
        row = self._row.get(int(camera))
        if row is None:
            return image
        gain = torch.exp(self.log_gain[row] - self.log_gain.mean(0))
        return image * gain + (self.offset[row] - self.offset.mean(0))


def colour_recorders(views: Views) -> np.ndarray | None:
    """Sorted numbers of what recorded the training frames, which may disagree about colour. None with one alone, and where nearly each
    frame is said to be a camera of its own, which is how rendered captures are written."""
    if views.recorder is not None:
        recorders = np.unique(views.recorder[views.train])
        return recorders if len(recorders) > 1 else None
    cameras = np.unique(views.camera[views.train])
    return cameras if len(cameras) > 1 and len(views.train) > 1.5 * len(cameras) else None
