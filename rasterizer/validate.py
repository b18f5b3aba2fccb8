"""Checks of values: of a camera (raises), and of each primitive (gives a mask for culling, or an error that names the primitive)."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import fields

import torch
from torch import Tensor

from .arguments import check
from .types import Camera, Convexes, Gaussians

SKEW = 1e-6  # relative to fx; smaller skew is taken for a rounding error in K
LAST_ROW = 1e-3  # largest deviation of cam_from_world's last row from 0 0 0 1; a larger one suggests a transposed matrix

_RANGES: dict[str, tuple[str, Callable[[Tensor], Tensor]]] = {
    "scales": ("> 0", lambda x: x > 0),
    "tau": ("> 0", lambda x: x > 0),
    "kappa": ("> 0", lambda x: x > 0),
    "opacities": ("in [0, 1]", lambda x: (x >= 0) & (x <= 1)),
    "quats": ("non-zero", lambda x: (x != 0).any(-1, keepdim=True)),
}


Matrix = list[list[float]]


def check_camera(camera: Camera, values: bool = True) -> tuple[Matrix, Matrix] | None:
    """The rows of K and of cam_from_world. ``values=False`` reads no tensor values and returns None.

    Raises a TypeError or ValueError that names the field if this camera cannot be used.
    """
    if not isinstance(camera, Camera):
        raise TypeError(f"camera must be a Camera, got {type(camera).__name__}")
    check("camera.K", camera.K, (3, 3))
    check("camera.cam_from_world", camera.cam_from_world, (4, 4), camera.K.device)
    for name in ("width", "height"):
        value = getattr(camera, name)
        if isinstance(value, bool) or not isinstance(value, int):
            raise TypeError(f"camera.{name} must be an int, got {type(value).__name__}")
        if value < 1:
            raise ValueError(f"camera.{name} must be at least 1, got {value}")
    if not 0 < camera.near < float("inf"):
        raise ValueError(f"camera.near must be positive and finite, got {camera.near}")
    if not values:
        return None
    K, pose = _rows(camera)
    for name, rows in (("K", K), ("cam_from_world", pose)):
        if not all(math.isfinite(value) for row in rows for value in row):
            raise ValueError(f"camera.{name} must be finite, got {rows}")
    if K[0][0] <= 0 or K[1][1] <= 0:
        raise ValueError(f"camera.K must have positive focal lengths, got fx={K[0][0]}, fy={K[1][1]}")
    if max(abs(K[0][1]), abs(K[1][0])) > SKEW * K[0][0]:
        raise ValueError(f"camera.K has skew ({K[0][1]}, {K[1][0]}), which is not supported; undistort or rectify the images first")
    last = pose[3]
    if max(abs(a - b) for a, b in zip(last, (0.0, 0.0, 0.0, 1.0))) > LAST_ROW:
        raise ValueError(f"camera.cam_from_world must end with the row 0 0 0 1, got {last}; is it transposed?")
    return K, pose


def _rows(camera: Camera) -> tuple[Matrix, Matrix]:
    if camera.K.device.type == "cpu":
        return camera.K.tolist(), camera.cam_from_world.tolist()
    # One transfer, because every transfer from another device waits for all work queued before it.
    numbers = torch.cat([camera.K.detach().double().flatten(), camera.cam_from_world.detach().double().flatten()]).tolist()
    return [numbers[at : at + 3] for at in (0, 3, 6)], [numbers[at : at + 4] for at in (9, 13, 17, 21)]


def bad_values(owner: Gaussians | Convexes) -> dict[str, Tensor]:
    """For each field, [N] bool: the primitives whose value in that field is non-finite or out of range.

    Values are judged after rounding to float32, so that all backends cull the same primitives, whatever precision they compute in.
    """
    found = {}
    for field in fields(owner):
        value = getattr(owner, field.name)
        if value is None:
            continue
        value = value.detach().to(torch.float32)
        good = torch.isfinite(value)
        if field.name in _RANGES:
            good = good & _RANGES[field.name][1](value)
        found[field.name] = ~good.flatten(1).all(1) if good.dim() > 1 else ~good
    return found


def usable(owner: Gaussians | Convexes) -> Tensor:
    """[N] bool: True for primitives whose values are all finite and in range. The others are culled."""
    return ~torch.stack(list(bad_values(owner).values())).any(0)


def check_values(owner: Gaussians | Convexes) -> None:
    """Raise a ValueError that names the first field with a bad value, and the index of the first primitive that has one there."""
    kind = type(owner).__name__.lower()
    for name, bad in bad_values(owner).items():
        if not bool(bad.any()):
            continue
        index = int(bad.nonzero()[0])
        value = getattr(owner, name)[index].tolist()
        wanted = f"finite and {_RANGES[name][0]}" if name in _RANGES else "finite"
        raise ValueError(f"{kind}.{name}[{index}] must be {wanted}, got {value} ({int(bad.sum())} of {len(bad)} are bad)")
