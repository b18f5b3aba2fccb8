"""Brings primitives of both kinds and cameras into the uniform form that backends want."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache
from typing import Any, TypeVar

import torch
from torch import Tensor

from .arguments import POINTS
from .types import Camera, Convexes, Gaussians
from .validate import Matrix

Owner = TypeVar("Owner", Camera, Gaussians, Convexes)

FAR_CAMERA = 1e3  # world units; beyond this, float32 coordinates are off by more than a hundredth of a pixel, so the scene is recentred


@cache  # a frame of few primitives takes hardly longer than this
def no_gaussians(dtype: torch.dtype, device: torch.device) -> Gaussians:
    with torch.inference_mode(False):  # a later frame may need gradients
        none = torch.zeros(0, dtype=dtype, device=device)
        return Gaussians(none.view(0, 3), none.view(0, 4), none.view(0, 3), none, colors=none.view(0, 3))


@cache
def no_convexes(dtype: torch.dtype, device: torch.device) -> Convexes:
    with torch.inference_mode(False):
        none = torch.zeros(0, dtype=dtype, device=device)
        return Convexes(none.view(0, POINTS[0], 3), none, none, none, colors=none.view(0, 3))


def pad_extras(gaussians: Gaussians, convexes: Convexes) -> tuple[Gaussians, Convexes]:
    """Give both kinds extras of the same width: zeros for a kind that has none, width 0 if neither has any."""
    ours, theirs = gaussians.extras, convexes.extras
    if ours is not None and theirs is not None and ours.shape[1] != theirs.shape[1]:
        raise ValueError(f"gaussians.extras and convexes.extras must have one width, got {list(ours.shape)} and {list(theirs.shape)}")
    if ours is not None and theirs is not None:
        return gaussians, convexes
    width = ours.shape[1] if ours is not None else theirs.shape[1] if theirs is not None else 0
    if ours is None:
        gaussians = Gaussians(**vars(gaussians) | {"extras": gaussians.means.new_zeros(gaussians.means.shape[0], width)})
    if theirs is None:
        convexes = Convexes(**vars(convexes) | {"extras": convexes.points.new_zeros(convexes.points.shape[0], width)})
    return gaussians, convexes


def cast(owner: Owner, dtype: torch.dtype) -> Owner:
    """Convert every tensor of a dataclass to a contiguous tensor of this dtype that stays attached to the autograd graph."""
    tensors = {name: value for name, value in vars(owner).items() if isinstance(value, Tensor)}
    if all(value.dtype == dtype and value.is_contiguous() for value in tensors.values()):
        return owner
    changes: dict[str, Any] = {name: value.to(dtype).contiguous() for name, value in tensors.items()}
    return replace(owner, **changes)


def recentre(camera: Camera, pose: Matrix, gaussians: Gaussians, convexes: Convexes) -> tuple[Camera, Gaussians, Convexes]:
    """Translate scene and camera together, so that a far camera is near the origin before coordinates are rounded to float32.

    The image stays the same (means - c and t + R c for any fixed c). So do the gradients, except for the component of
    cam_from_world's gradient that leaves the rigid transforms and comes from the view direction of SH. So this is done only if it pays off.
    """
    place = [-sum(pose[row][column] * pose[row][3] for row in range(3)) for column in range(3)]
    if math.hypot(*place) <= FAR_CAMERA:
        return camera, gaussians, convexes
    world = camera.cam_from_world.double()
    centre = world.new_tensor(place).to(torch.float32)  # exactly representable in both dtypes
    moved = world[:, 3:] + world[:, :3] @ centre.double()[:, None]
    return (
        replace(camera, cam_from_world=torch.cat([world[:, :3], moved], 1)),
        replace(gaussians, means=gaussians.means - centre.to(gaussians.means)),
        replace(convexes, points=convexes.points - centre.to(convexes.points)),
    )
