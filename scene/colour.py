"""Real cameras disagree about colour: one affine a channel and camera, learned against a fixed mean."""

from __future__ import annotations

from collections.abc import Iterable

import torch
from torch import Tensor, nn


class CameraAffine(nn.Module):
    """Gain and offset [cameras, 3] each. Over the training cameras gains multiply to one and offsets add to zero, so that the model's
    own colours stay those of the mean camera, which is what held-out cameras are rendered with.

    cameras: the numbers of the training cameras, in the order of the rows.
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
