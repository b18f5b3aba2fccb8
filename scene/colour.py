"""Real cameras disagree about colour: one affine a channel and camera, learned against a fixed mean."""

from __future__ import annotations

import torch
from torch import Tensor, nn


class CameraAffine(nn.Module):
    """Gain and offset [cameras, 3] each. Over the training cameras gains multiply to one and offsets add to zero, so that the model's
    own colours stay those of the mean camera, which is what held-out cameras are rendered with.
    """

    def __init__(self, cameras: int) -> None:
        super().__init__()
        self.log_gain = nn.Parameter(torch.zeros(cameras, 3))
        self.offset = nn.Parameter(torch.zeros(cameras, 3))

    def forward(self, image: Tensor, camera: int) -> Tensor:
        """``image`` [H, W, 3] as camera number ``camera`` would record it."""
        gain = torch.exp(self.log_gain[camera] - self.log_gain.mean(0))
        return image * gain + (self.offset[camera] - self.offset.mean(0))
