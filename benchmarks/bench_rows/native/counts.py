"""(pixel, primitive) pairs: how many a scene has, and what blending so many costs at least."""

from __future__ import annotations

import ctypes
from dataclasses import dataclass

import torch
from e4dgs.rasterizer.reference.blend import MAX_ALPHA, MIN_ALPHA, MIN_TRANSMITTANCE
from e4dgs.rasterizer.reference.convexes import Shapes
from e4dgs.rasterizer.reference.gaussians import DILATION, Splats
from e4dgs.rasterizer.reference.scene import Scene
from e4dgs.rasterizer.types import Camera
from rasterizer.thresholds import projected
from torch import Tensor

from .library import library


@dataclass
class Pairs:
    """Pairs with alpha >= 1/255: all of them, and those in front of their pixel's stop."""

    visible: int
    blended: int


def blend_limit(pairs: int, backward: bool) -> None:
    """Evaluate and blend this many pairs of a pixel and a Gaussian, with nothing else, on all of torch's threads."""
    library().blend_limit(ctypes.c_int64(pairs), int(backward), torch.get_num_threads())


@torch.no_grad()
def count_pairs(scene: Scene) -> Pairs:
    """Pairs of ``scene`` by the formulas of the reference, in float64."""
    camera, splats, shapes = projected(scene)
    gaussians, convexes = conics(splats), lines(shapes, camera)
    order = torch.argsort(torch.cat([splats.depths, shapes.depths]), stable=True)
    rules = torch.tensor([MIN_ALPHA, MAX_ALPHA, MIN_TRANSMITTANCE], dtype=torch.float64)
    counts = torch.zeros(2, dtype=torch.int64)
    n, m, edges = len(gaussians), len(convexes), shapes.normals.shape[1]
    library().count_pairs(
        *(camera.width, camera.height, _at(rules), ctypes.c_int64(n), _at(gaussians), ctypes.c_int64(m), _at(convexes)),
        *(edges, _at(order), torch.get_num_threads(), _at(counts)),
    )
    return Pairs(*counts.tolist())


def conics(splats: Splats) -> Tensor:
    """[n, 6] x, y, a, b, c, opacity as in pairs.cpp."""
    m1, m2 = splats.factors.unbind(1)
    xx, yy, xy = m1.square().sum(-1) + DILATION, m2.square().sum(-1) + DILATION, (m1 * m2).sum(-1)
    det = torch.linalg.cross(m1, m2).square().sum(-1) + DILATION * (xx + yy) - DILATION**2
    return torch.stack([*splats.centres.unbind(-1), yy / det, -xy / det, xx / det, splats.opacities], -1).contiguous()


def lines(shapes: Shapes, camera: Camera) -> Tensor:
    """[m, 2 + 3 K] opacity, rho, and A, B, C of each edge as in pairs.cpp."""
    fx, fy, cx, cy = camera.K[0, 0], camera.K[1, 1], camera.K[0, 2], camera.K[1, 2]
    A, B = shapes.normals[..., 0] / fx, shapes.normals[..., 1] / fy
    scale = (shapes.tau * shapes.depths)[:, None]
    found = torch.stack([scale * A, scale * B, scale * (shapes.normals[..., 2] - A * cx - B * cy) + shapes.log_weights], -1)
    return torch.cat([torch.stack([shapes.opacities, shapes.kappa / shapes.tau], -1), found.flatten(1)], 1).contiguous()


def _at(values: Tensor) -> ctypes.c_void_p:
    return ctypes.c_void_p(values.data_ptr())
