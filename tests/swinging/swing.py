"""Primitives that swing to and fro, each along its own arm and all in one rhythm."""

from __future__ import annotations

import math
from typing import ClassVar

import torch
from e4dgs.scene.motion.interface import Motion, Moved, drawn
from e4dgs.scene.motion.rates import exponential
from e4dgs.scene.primitives import Attribute
from torch import nn


class Swing(Motion):
    """A dynamic primitive is displaced by its `arm` [3] (world units) times sin(2 pi rhythm t)."""

    kind = "swing"
    attributes: ClassVar = {"arm": Attribute((3,))}

    def __init__(self):
        super().__init__()
        self.rhythm = nn.Parameter(torch.ones(()))

    def shifts(self, primitives, t):
        return primitives.dynamic[:, None] * primitives.arm * torch.sin(2 * math.pi * self.rhythm * t)

    def primitives_at(self, scene, t, camera, sh_degree):
        g, c = scene.gaussians, scene.convexes
        means, points = g.means + self.shifts(g, t), c.points + self.shifts(c, t)[:, None]
        return drawn(scene, sh_degree, means=means, points=points)

    def carried(self, scene, index, t):
        g = scene.gaussians
        return Moved(g.means[index] + g.arm[index] * torch.sin(2 * math.pi * self.rhythm * t), g.quats[index], None)

    def attribute_rates(self, settings, unit, scale):
        return {"arm": exponential(settings.lr_means * unit * scale, settings.lr_means * unit / 50)}
