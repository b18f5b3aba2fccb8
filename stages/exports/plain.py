"""How programs draw the Gaussians of an antialiased model, and how these are adjusted for programs that draw in the classic mode."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from ...rasterizer import Camera, Gaussians
from ...rasterizer.reference.gaussians import DILATION, PIXEL_VARIANCE
from ...scene.model import Model
from ...scene.training.control.hidden import footprint
from ...scene.views import inside_image
from ..shared.posed_frameset import PosedFrameSet
from .capture_cameras import camera_of, distinct_views

VIEWS = 24  # training views over which the adjustment is averaged
LEAST_SCALE = 0.5  # of its own, to which a standard deviation may shrink: what is smaller than a pixel cannot lose all its extent


@dataclass
class PlainLook:
    """share [N]: factors on opacities. excess [N]: variance that the classic mode adds to a Gaussian beyond what the antialiased mode adds,
    at the distance of the training views, world units squared. Both are right at the size and distance of the training views."""

    share: Tensor
    excess: Tensor

    @classmethod
    def unchanged(cls, count: int) -> PlainLook:
        return cls(torch.ones(count), torch.zeros(count))

    @classmethod
    def of(cls, model: Model, frames: PosedFrameSet) -> PlainLook:
        """Averages over some training views; unchanged if ``model`` is not antialiased."""
        found = cls.unchanged(len(model.gaussians))
        if not model.antialiased:
            return found
        with torch.no_grad():
            looks = []
            for i in distinct_views(frames, frames.train, VIEWS):
                camera, (gaussians, _) = camera_of(model, frames, int(i)), model.at(float(frames.time[i]))
                looks.append((camera, gaussians, inside_image(camera, gaussians.means).float()))
            count = torch.stack([seen for _, _, seen in looks]).sum(0)

            def mean(of: Callable[[Camera, Gaussians], Tensor]) -> Tensor:
                return torch.stack([of(camera, gaussians) * seen for camera, gaussians, seen in looks]).sum(0) / count.clamp(min=1)

            found.excess = (DILATION - PIXEL_VARIANCE) * mean(pixel_area)
            found.share = mean(lambda c, g: footprint(c, g, dilation=0.0) / footprint(c, found.narrowed(g)).clamp(min=1e-12))
            found.share = torch.where(count > 0, found.share, 1.0)
        return found

    def narrowed(self, gaussians: Gaussians) -> Gaussians:
        """``gaussians`` without the excess of variance."""
        scales = gaussians.scales
        variances = (scales.square() - self.excess[:, None]).maximum((LEAST_SCALE * scales).square())
        return replace(gaussians, scales=variances.sqrt())

    def __call__(self, gaussians: Gaussians) -> Gaussians:
        """``gaussians`` as such programs should get them."""
        return replace(self.narrowed(gaussians), opacities=(gaussians.opacities * self.share).clamp(max=1.0))


def compensated(camera: Camera, gaussians: Gaussians) -> Gaussians:
    """``gaussians`` with opacities with which the classic mode draws them before ``camera`` as antialiased viewers do: these add 0.3 px^2
    to the projected covariance S, too, and lower opacity by sqrt(det S / det(S + 0.3 I)) (gsplat's rasterize_mode "antialiased", Spark)."""
    share = footprint(camera, gaussians, dilation=0.0) / footprint(camera, gaussians).clamp(min=1e-12)
    return replace(gaussians, opacities=gaussians.opacities * share)


def pixel_area(camera: Camera, gaussians: Gaussians) -> Tensor:
    """[N] area of a pixel at the depth of each centre, world units squared."""
    z = gaussians.means @ camera.cam_from_world[2, :3] + camera.cam_from_world[2, 3]
    return z.square() / (camera.K[0, 0] * camera.K[1, 1])
