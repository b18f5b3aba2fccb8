"""The public entry point: checks its arguments, brings both kinds of primitive into a uniform form, and calls one backend."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache
from typing import Any, Literal, TypeVar

import torch
from torch import Tensor

from .types import TILE, Camera, Convexes, Frame, Gaussians
from .validate import Matrix, check_camera, check_values

Backend = Literal["auto", "cpu", "cuda", "reference"]
Owner = TypeVar("Owner", Camera, Gaussians, Convexes)

SH_COEFFICIENTS = (1, 4, 9, 16)
POINTS = (3, 8)
FLOATS = (torch.float32, torch.float64)
FAR_CAMERA = 1e3  # world units; beyond this, float32 coordinates are off by more than a hundredth of a pixel, so the scene is recentred


def rasterize(
    camera: Camera,
    gaussians: Gaussians | None = None,
    convexes: Convexes | None = None,
    background: Tensor | None = None,
    *,
    backend: Backend = "auto",
    validate: bool = False,
    antialiased: bool = False,
    tiles: Tensor | None = None,
) -> Frame:
    """Render Gaussians and convexes, depth-sorted together and blended front to back in one pass (Edge4DGS, Eq. 1-7).

    camera: see `Camera`. gaussians, convexes: see `Gaussians`, `Convexes`; either may be None or empty.
    background: [3] float, the colour behind the primitives; None is black.
    backend: "cpu" (C++ kernels, float32), "cuda" (float32), "reference" (plain torch, float64), or "auto", which selects the
        kernels for the device of the tensors.
    validate: if True, non-finite or out-of-range values of a primitive raise an error. If False, only the affected primitives are
        culled, with zero gradient. A non-finite camera or background always raises.
    antialiased: if True, a primitive smaller than a pixel fades instead of being drawn as large as a pixel, and one that comes close to
        the camera fades or is clipped instead of vanishing. Gaussians: 0.1 px^2 instead of 0.3 are added to the 2D covariance, and the
        opacity is multiplied by sqrt(det cov / det(cov + 0.1 I)). Convexes: no edge is sharper than a pixel, the opacity keeps the total
        that a sharp convex would have, and points nearer than `near` are moved to that plane. Both: the opacity falls smoothly from
        z = 2 near to 0 at z = near. The formulas are in docs/maths.md. Models are trained for one mode.

    tiles: [ceil(H / TILE), ceil(W / TILE)] bool, the squares of `TILE` px that are drawn, from the top left; None: all. Elsewhere the frame
        shows the background, with alpha 0 and no gradient to the primitives, and costs nearly nothing.

    Inputs are float32 or float64 tensors on one device. Gradients flow to all of them, including K and cam_from_world. If the primitives
    are on a CUDA device, the camera, the background and the tiles may stay on the CPU, which avoids waiting for the device. While a CUDA
    graph is being captured they must be on the device, and values are not checked.

    Raises TypeError for anything that is not a float tensor, ValueError for bad shapes and values (both name the field), RuntimeError
    if the backend cannot be loaded.
    """
    capturing = torch.cuda.is_available() and torch.cuda.is_current_stream_capturing()
    rows = check_camera(camera, values=not capturing)
    device = _device_of(camera, gaussians, convexes)
    gaussians = _no_gaussians(camera.K.dtype, device) if gaussians is None else gaussians
    convexes = _no_convexes(camera.K.dtype, device) if convexes is None else convexes
    _check_gaussians(gaussians)
    _check_convexes(convexes)
    if background is None:
        background = torch.zeros(3, dtype=camera.K.dtype, device=camera.K.device)
    _check("background", background, (3,), None if device.type == "cuda" and background.device.type == "cpu" else device)
    if not capturing and not all(map(math.isfinite, background.tolist())):
        raise ValueError(f"background must be finite, got {background.tolist()}")
    for owner in (gaussians, convexes):
        _check_device(owner, device)
    if tiles is not None:
        _check_tiles(tiles, camera)
    if validate:
        check_values(gaussians)
        check_values(convexes)
    if capturing:
        _check_capture(camera, background, tiles)
    if backend == "auto":
        backend = "cuda" if device.type == "cuda" else "cpu"
    if backend != "cuda" or gaussians.extras is not None or convexes.extras is not None:  # these kernels need no extras of width 0
        gaussians, convexes = _pad_extras(gaussians, convexes)
    if backend == "reference":
        from .reference import rasterize_reference

        double = torch.float64
        return rasterize_reference(
            _cast(camera, double), _cast(gaussians, double), _cast(convexes, double), background.to(double).contiguous(), antialiased, tiles
        )
    if backend == "cpu":
        if device.type != "cpu":
            raise ValueError(f"backend 'cpu' wants tensors on the CPU, got {device}; move them with .cpu()")
        try:
            from .cpu_backend import rasterize_cpu
        except ImportError as cause:
            raise RuntimeError(
                f"the CPU kernels of e4dgs.rasterizer cannot be loaded ({cause}); reinstall the package with a C++20 compiler "
                "present, or use backend='reference' (slow)"
            ) from cause
        single = torch.float32
        assert rows is not None
        camera, gaussians, convexes = _recentre(camera, rows[1], gaussians, convexes)
        # The camera stays in float64: it is small, and every primitive's position goes through it.
        camera = _cast(camera, torch.float64)
        return rasterize_cpu(
            camera, _cast(gaussians, single), _cast(convexes, single), background.to(single).contiguous(), antialiased, tiles
        )
    if backend == "cuda":
        from .cuda_backend import rasterize_cuda

        single = torch.float32
        if rows is not None:
            camera, gaussians, convexes = _recentre(camera, rows[1], gaussians, convexes)
        return rasterize_cuda(camera, _cast(gaussians, single), _cast(convexes, single), background, antialiased, tiles)
    raise ValueError(f"backend must be 'auto', 'cpu', 'cuda' or 'reference', got {backend!r}")


def _check(name: str, value: object, shape: tuple[int | None, ...], device: torch.device | None = None) -> None:
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


def _device_of(camera: Camera, gaussians: Gaussians | None, convexes: Convexes | None) -> torch.device:
    """The device that all tensors must be on: the camera's, or the primitives' if those are on a CUDA device and the camera on the CPU."""
    for value in (getattr(gaussians, "means", None), getattr(convexes, "points", None)):
        if isinstance(value, Tensor) and value.device.type == "cuda" and camera.K.device.type == "cpu":
            return value.device
    return camera.K.device


def _check_device(owner: Gaussians | Convexes, device: torch.device) -> None:
    for name, value in vars(owner).items():
        if value is not None and value.device != device:
            kind = type(owner).__name__.lower()
            raise ValueError(f"{kind}.{name} is on {value.device}, but the others are on {device}; all tensors must be on one device")


def _check_gaussians(gaussians: Gaussians) -> None:
    if not isinstance(gaussians, Gaussians):
        raise TypeError(f"gaussians must be Gaussians or None, got {type(gaussians).__name__}")
    _check("gaussians.means", gaussians.means, (None, 3))
    n = gaussians.means.shape[0]
    _check("gaussians.quats", gaussians.quats, (n, 4))
    _check("gaussians.scales", gaussians.scales, (n, 3))
    _check("gaussians.opacities", gaussians.opacities, (n,))
    _check_looks("gaussians", gaussians, n)


def _check_convexes(convexes: Convexes) -> None:
    if not isinstance(convexes, Convexes):
        raise TypeError(f"convexes must be Convexes or None, got {type(convexes).__name__}")
    _check("convexes.points", convexes.points, (None, None, 3))
    m, k = convexes.points.shape[:2]
    if not POINTS[0] <= k <= POINTS[1]:
        raise ValueError(f"convexes.points must have {POINTS[0]} to {POINTS[1]} points each, got {list(convexes.points.shape)}")
    for name in ("tau", "kappa", "opacities"):
        _check(f"convexes.{name}", getattr(convexes, name), (m,))
    _check_looks("convexes", convexes, m)


def _check_looks(kind: str, owner: Gaussians | Convexes, n: int) -> None:
    """Check colours, SH and extras. The rules are the same for both kinds of primitive."""
    if (owner.sh is None) == (owner.colors is None):
        raise ValueError(f"{kind}: give exactly one of sh and colors, got {'neither' if owner.sh is None else 'both'}")
    if owner.colors is not None:
        _check(f"{kind}.colors", owner.colors, (n, 3))
    if owner.sh is not None:
        _check(f"{kind}.sh", owner.sh, (n, None, 3))
        if owner.sh.shape[1] not in SH_COEFFICIENTS:
            raise ValueError(f"{kind}.sh must have 1, 4, 9 or 16 coefficients (degree 0 to 3), got {list(owner.sh.shape)}")
    if owner.extras is not None:
        _check(f"{kind}.extras", owner.extras, (n, None))


def _pad_extras(gaussians: Gaussians, convexes: Convexes) -> tuple[Gaussians, Convexes]:
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


@cache  # a frame of few primitives takes hardly longer than this
def _no_gaussians(dtype: torch.dtype, device: torch.device) -> Gaussians:
    with torch.inference_mode(False):  # a later frame may need gradients
        none = torch.zeros(0, dtype=dtype, device=device)
        return Gaussians(none.view(0, 3), none.view(0, 4), none.view(0, 3), none, colors=none.view(0, 3))


@cache
def _no_convexes(dtype: torch.dtype, device: torch.device) -> Convexes:
    with torch.inference_mode(False):
        none = torch.zeros(0, dtype=dtype, device=device)
        return Convexes(none.view(0, POINTS[0], 3), none, none, none, colors=none.view(0, 3))


def _cast(owner: Owner, dtype: torch.dtype) -> Owner:
    """Convert every tensor of a dataclass to a contiguous tensor of this dtype that stays attached to the autograd graph."""
    tensors = {name: value for name, value in vars(owner).items() if isinstance(value, Tensor)}
    if all(value.dtype == dtype and value.is_contiguous() for value in tensors.values()):
        return owner
    changes: dict[str, Any] = {name: value.to(dtype).contiguous() for name, value in tensors.items()}
    return replace(owner, **changes)


def _recentre(camera: Camera, pose: Matrix, gaussians: Gaussians, convexes: Convexes) -> tuple[Camera, Gaussians, Convexes]:
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
