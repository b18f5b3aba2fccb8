"""The public entry point: checks its arguments, brings both kinds of primitive into a uniform form, and calls one backend."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import torch
from torch import Tensor

from .arguments import check_picture, check_primitives, device_of
from .types import Camera, Convexes, Frame, Gaussians
from .uniform import cast, no_convexes, no_gaussians, pad_extras, recentre
from .validate import check_camera, check_values

Backend = Literal["auto", "cpu", "cuda", "reference"]
Kernels = Callable[[Camera, Gaussians, Convexes, Tensor, bool, Tensor | None], Frame]


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
    device = device_of(camera, gaussians, convexes)
    gaussians = no_gaussians(camera.K.dtype, device) if gaussians is None else gaussians
    convexes = no_convexes(camera.K.dtype, device) if convexes is None else convexes
    if background is None:
        background = torch.zeros(3, dtype=camera.K.dtype, device=camera.K.device)
    check_primitives(gaussians, convexes, device)
    check_picture(camera, background, tiles, device, capturing)
    if validate:
        check_values(gaussians)
        check_values(convexes)
    if backend == "auto":
        backend = "cuda" if device.type == "cuda" else "cpu"
    if backend not in ("cpu", "cuda", "reference"):
        raise ValueError(f"backend must be 'auto', 'cpu', 'cuda' or 'reference', got {backend!r}")
    if backend == "cpu" and device.type != "cpu":
        raise ValueError(f"backend 'cpu' wants tensors on the CPU, got {device}; move them with .cpu()")
    if backend != "cuda" or gaussians.extras is not None or convexes.extras is not None:  # these kernels need no extras of width 0
        gaussians, convexes = pad_extras(gaussians, convexes)
    if backend != "reference" and rows is not None:
        camera, gaussians, convexes = recentre(camera, rows[1], gaussians, convexes)
    # CPU kernels and the reference take the camera in float64: it is small, and every primitive's position goes through it.
    precision = torch.float64 if backend == "reference" else torch.float32
    camera = camera if backend == "cuda" else cast(camera, torch.float64)
    background = background if backend == "cuda" else background.to(precision).contiguous()
    return _kernels(backend)(camera, cast(gaussians, precision), cast(convexes, precision), background, antialiased, tiles)


def _kernels(backend: Backend) -> Kernels:
    """The function of a backend, whose module is loaded now: a machine without a GPU or a compiler can use the others."""
    if backend == "reference":
        from .reference import rasterize_reference

        return rasterize_reference
    if backend == "cuda":
        from .cuda_backend import rasterize_cuda

        return rasterize_cuda
    try:
        from .cpu_backend import rasterize_cpu
    except ImportError as cause:
        raise RuntimeError(
            f"the CPU kernels of e4dgs.rasterizer cannot be loaded ({cause}); reinstall the package with a C++20 compiler "
            "present, or use backend='reference' (slow)"
        ) from cause
    return rasterize_cpu
