"""Motions that are defined at places, so that they carry whatever is there."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, NamedTuple

import torch
from torch import Tensor

from ...rasterizer import Camera, Convexes, Gaussians
from .interface import Motion, Moved, Scene, drawn
from .times import Time


class Places(NamedTuple):
    """Places at rest, which are carried: the centres of M Gaussians, followed by corners of convexes.

    points: [N, 3] world units. quats: [M, 4] of the Gaussians, w x y z, any norm. attributes: of each point, by the names of
    `Carrier.placed_by`. link: [N, k] int32, see `Motion.links`.
    """

    points: Tensor
    quats: Tensor
    attributes: Mapping[str, Tensor]
    link: Tensor | None


class Carrier(Motion):
    """A motion that tells for each place at rest where it goes."""

    placed_by: ClassVar[tuple[str, ...]] = ()  # those of `attributes` that `carry` looks at in addition to the position

    def carry(self, rest: Places, t: Time) -> Moved:
        """``rest`` at time ``t`` in [0, 1]. Positions get gradients through the transform that moves them, not through the look-up."""
        raise NotImplementedError

    def light_at(self, t: Time) -> Tensor | None:
        """How bright the scene's light is at ``t``: courses [C], which each primitive follows by its own attribute `shades`; None if
        colours do not change over time."""
        return None

    def primitives_at(self, scene: Scene, t: Time, camera: Camera | None, sh_degree: int) -> tuple[Gaussians, Convexes]:
        g, c = scene.gaussians, scene.convexes
        means, quats, log_scales, points = g.means, g.quats, g.log_scales, c.points
        light = self.light_at(t)
        index, convex_index = scene.moving(g, camera), scene.moving(c, camera)
        n = len(index)
        if n + len(convex_index):
            moved = self.carry(self.rest(scene, index, convex_index), t)
            if n == len(means):  # the usual case in small scenes; avoids indexed copies
                means, quats = moved.points[:n], moved.quats
                log_scales = log_scales if moved.log_scales is None else log_scales + moved.log_scales
            else:
                means = means.index_copy(0, index, moved.points[:n])
                quats = quats.index_copy(0, index, moved.quats)
                log_scales = log_scales if moved.log_scales is None else log_scales.index_add(0, index, moved.log_scales)
            if len(convex_index):
                points = points.index_copy(0, convex_index, moved.points[n:].reshape(-1, *points.shape[1:]))
        return drawn(scene, sh_degree, means, quats, log_scales, points, light)

    def carried(self, scene: Scene, index: Tensor, t: float) -> Moved:
        return self.carry(self.rest(scene, index, index[:0]), t)

    def rest(self, scene: Scene, index: Tensor, convex_index: Tensor) -> Places:
        """The Gaussians ``index`` and the corners of the convexes ``convex_index``."""
        g, c = scene.gaussians, scene.convexes
        whole = len(index) == len(g)
        # Not by brackets, whose gradient on a GPU sorts the indices first.
        names = "means", "quats", *self.placed_by
        points, quats, *others = (p if whole else p.index_select(0, index) for p in (g.parameters[name] for name in names))
        attributes = dict(zip(self.placed_by, others))
        link = scene.links(g)
        link = link if whole or link is None else link[index]
        if len(convex_index):
            corners = c.points.shape[1]
            points = torch.cat([points, c.points.index_select(0, convex_index).reshape(-1, 3)])
            for name, of_gaussians in attributes.items():
                of_corners = c.parameters[name].index_select(0, convex_index).repeat_interleave(corners, 0)
                attributes[name] = torch.cat([of_gaussians, of_corners])
            other = scene.links(c)
            if link is not None and other is not None:
                link = torch.cat([link, other.reshape(len(c), corners, -1)[convex_index].flatten(0, 1)])
        return Places(points, quats, attributes, link)
