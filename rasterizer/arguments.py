"""Checks of the arguments of `rasterize`: types, shapes and devices. Values are checked in `validate.py`."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from .types import TILE, Camera, Convexes, Gaussians

SH_COEFFICIENTS = (1, 4, 9, 16)
POINTS = (3, 8)
FLOATS = (torch.float32, torch.float64)


def device_of(camera: Camera, gaussians: Gaussians | None, convexes: Convexes | None) -> torch.device:
    """The device that all tensors must be on: the camera's, or the primitives' if those are on a CUDA device and the camera on the CPU."""
    for value in (getattr(gaussians, "means", None), getattr(convexes, "points", None)):
        if isinstance(value, Tensor) and value.device.type == "cuda" and camera.K.device.type == "cpu":
            return value.device
    return camera.K.device


def check_primitives(gaussians: Gaussians, convexes: Convexes, device: torch.device) -> None:
    """Raise TypeError or ValueError unless both have the fields, dtypes and shapes of their class, and lie on ``device``."""
    _check_gaussians(gaussians, device)
    _check_convexes(convexes, device)


def check_picture(camera: Camera, background: Tensor, tiles: Tensor | None, device: torch.device, capturing: bool) -> None:
    """Raise TypeError, ValueError or RuntimeError unless ``background`` and ``tiles`` fit the camera and ``device``. They may stay on the
    CPU if that is a CUDA device, but not while a CUDA graph is being captured, when no values are read either."""
    check("background", background, (3,), None if device.type == "cuda" and background.device.type == "cpu" else device)
    if not capturing and not all(map(math.isfinite, background.tolist())):
        raise ValueError(f"background must be finite, got {background.tolist()}")
    if tiles is not None:
        _check_tiles(tiles, camera)
    if capturing:
        _check_capture(camera, background, tiles)


def check(name: str, value: object, shape: tuple[int | None, ...], device: torch.device | None = None) -> None:
    """Raise unless the value is a float32 or float64 tensor of this shape (None: any length) on this device (None: any)."""
    if not isinstance(value, Tensor):
        raise TypeError(f"{name} must be a torch.Tensor, got {type(value).__name__}")
    if value.dtype not in FLOATS:
        raise TypeError(f"{name} must be float32 or float64, got {value.dtype}")
    given = value.shape
    if given != shape and (len(given) != len(shape) or any(want is not None and got != want for got, want in zip(given, shape))):
        wanted = ", ".join("*" if n is None else str(n) for n in shape)
        raise ValueError(f"{name} must have shape [{wanted}], got {list(value.shape)}")
    if device is not None and value.device != device:
        raise ValueError(f"{name} is on {value.device}, but the others are on {device}; all tensors must be on one device")


def _check_tiles(tiles: Tensor, camera: Camera) -> None:
    if not isinstance(tiles, Tensor) or tiles.dtype != torch.bool:
        raise TypeError(f"tiles must be a bool torch.Tensor, got {tiles.dtype if isinstance(tiles, Tensor) else type(tiles).__name__}")
    wanted = (-(-camera.height // TILE), -(-camera.width // TILE))
    if tuple(tiles.shape) != wanted:
        raise ValueError(f"tiles must have shape {list(wanted)} for {camera.width} x {camera.height} px, got {list(tiles.shape)}")


def _check_capture(camera: Camera, background: Tensor, tiles: Tensor | None) -> None:
    """Raise RuntimeError if a CUDA graph would copy a tensor from the CPU: each replay would read that memory again, whatever it holds."""
    given = {"camera.K": camera.K, "camera.cam_from_world": camera.cam_from_world, "background": background, "tiles": tiles}
    for name, value in given.items():
        if value is not None and value.device.type != "cuda":
            raise RuntimeError(
                f"{name} is on the CPU while a CUDA graph is being captured; move it to the GPU with .cuda() before the capture"
            )


def _check_gaussians(gaussians: Gaussians, device: torch.device) -> None:
    if not isinstance(gaussians, Gaussians):
        raise TypeError(f"gaussians must be Gaussians or None, got {type(gaussians).__name__}")
    check("gaussians.means", gaussians.means, (None, 3), device)
    n = gaussians.means.shape[0]
    check("gaussians.quats", gaussians.quats, (n, 4), device)
    check("gaussians.scales", gaussians.scales, (n, 3), device)
    check("gaussians.opacities", gaussians.opacities, (n,), device)
    _check_looks("gaussians", gaussians, n, device)


def _check_convexes(convexes: Convexes, device: torch.device) -> None:
    if not isinstance(convexes, Convexes):
        raise TypeError(f"convexes must be Convexes or None, got {type(convexes).__name__}")
    check("convexes.points", convexes.points, (None, None, 3), device)
    m, k = convexes.points.shape[:2]
    if not POINTS[0] <= k <= POINTS[1]:
        raise ValueError(f"convexes.points must have {POINTS[0]} to {POINTS[1]} points each, got {list(convexes.points.shape)}")
    for name in ("tau", "kappa", "opacities"):
        check(f"convexes.{name}", getattr(convexes, name), (m,), device)
    _check_looks("convexes", convexes, m, device)


def _check_looks(kind: str, owner: Gaussians | Convexes, n: int, device: torch.device) -> None:
    """Check colours, SH and extras. The rules are the same for both kinds of primitive."""
    if (owner.sh is None) == (owner.colors is None):
        raise ValueError(f"{kind}: give exactly one of sh and colors, got {'neither' if owner.sh is None else 'both'}")
    if owner.colors is not None:
        check(f"{kind}.colors", owner.colors, (n, 3), device)
    if owner.sh is not None:
        check(f"{kind}.sh", owner.sh, (n, None, 3), device)
        if owner.sh.shape[1] not in SH_COEFFICIENTS:
            raise ValueError(f"{kind}.sh must have 1, 4, 9 or 16 coefficients (degree 0 to 3), got {list(owner.sh.shape)}")
    if owner.extras is not None:
        check(f"{kind}.extras", owner.extras, (n, None), device)
