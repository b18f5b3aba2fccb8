"""The CPU backend: a torch.autograd.Function around the C++ kernels. float32; results are bit-identical for any number of threads."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from . import _cpu  # type: ignore[attr-defined]
from .types import CONVEX_FIELDS, GAUSSIAN_FIELDS, IMAGES, Camera, Convexes, Frame, Gaussians

View = tuple[int, int, float, bool, Tensor | None]  # width, height, near, antialiased, tiles
LEADING = 3  # K, cam_from_world and background come before the primitives' fields


def rasterize_cpu(
    camera: Camera,
    gaussians: Gaussians,
    convexes: Convexes,
    background: Tensor,
    antialiased: bool = False,
    tiles: Tensor | None = None,
) -> Frame:
    """Render with the C++ kernels. Called by `rasterize`, which has checked the arguments and made them uniform.

    The primitives' tensors and the background are contiguous float32 on the CPU; the extras of both kinds have the same width E. K and
    cam_from_world may be float32 or float64 and are used in float64. Gradients are computed only for inputs that require them.
    """
    tensors = [camera.K.double(), camera.cam_from_world[:3].double(), background]
    tensors += [getattr(gaussians, name) for name in GAUSSIAN_FIELDS]
    tensors += [getattr(convexes, name) for name in CONVEX_FIELDS]
    return Frame(*_Rasterize.apply((camera.width, camera.height, camera.near, antialiased, tiles), *tensors))


class _Rasterize(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, view: View, *tensors: Tensor | None) -> tuple[Tensor, ...]:
        width, height, near, antialiased, tiles = view
        plain: list[Any] = [None if t is None else t.detach().contiguous() for t in tensors]
        K, cam_from_world, background = plain[:LEADING]
        gaussians = dict(zip(GAUSSIAN_FIELDS, plain[LEADING:]))
        convexes = dict(zip(CONVEX_FIELDS, plain[LEADING + len(GAUSSIAN_FIELDS) :]))
        channels = gaussians["extras"].shape[1]
        for kind in (gaussians, convexes):
            if not kind["extras"].any():  # nothing to blend: such extras are probes, of which only the gradients are wanted
                kind["extras"] = None
        frame = {
            "color": torch.empty(height, width, 3, dtype=torch.float32),
            "alpha": torch.empty(height, width, dtype=torch.float32),
            "depth": torch.empty(height, width, dtype=torch.float32),
            "extras": torch.empty(height, width, channels, dtype=torch.float32),
            "visible_gaussians": torch.zeros(gaussians["means"].shape[0], dtype=torch.uint8),
            "visible_convexes": torch.zeros(convexes["points"].shape[0], dtype=torch.uint8),
        }
        camera = {
            "K": K,
            "cam_from_world": cam_from_world,
            "background": background,
            "width": width,
            "height": height,
            "near": near,
            "extras": channels,
            "antialiased": antialiased,
            "tiles": None if tiles is None else tiles.to(torch.uint8).contiguous(),
        }
        keep = any(ctx.needs_input_grad)
        ctx.kept = _cpu.forward(camera, gaussians, convexes, frame, keep, torch.get_num_threads())
        ctx.set_materialize_grads(False)
        if keep:
            # Autograd checks versions: changing an input in place between forward and backward is an error, not a wrong gradient.
            ctx.save_for_backward(frame["alpha"], frame["depth"], *tensors)
        visible = frame["visible_gaussians"].bool(), frame["visible_convexes"].bool()
        ctx.mark_non_differentiable(*visible)
        return frame["color"], frame["alpha"], frame["depth"], frame["extras"], *visible

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *grads: Tensor | None) -> tuple[Any, ...]:
        alpha, depth, *tensors = ctx.saved_tensors
        grad: dict[str, Any] = {name: None if g is None else g.float().contiguous() for name, g in zip(IMAGES, grads)}
        grad |= {"alpha_image": alpha.detach(), "depth_image": depth.detach()}
        wanted = ctx.needs_input_grad[1:]
        # The kernels write every row of the primitives' gradients. In K's gradient, some entries are never written.
        make = [torch.zeros_like] * LEADING + [torch.empty_like] * (len(tensors) - LEADING)
        out = [new(t) if need and t is not None else None for new, need, t in zip(make, wanted, tensors)]
        camera: dict[str, Any] = {
            "camera": torch.zeros(16, dtype=torch.float64) if wanted[0] or wanted[1] else None,
            "background": torch.zeros(3, dtype=torch.float64) if wanted[2] else None,
        }
        gaussians = dict(zip(GAUSSIAN_FIELDS, out[LEADING:]))
        convexes = dict(zip(CONVEX_FIELDS, out[LEADING + len(GAUSSIAN_FIELDS) :]))
        _cpu.backward(ctx.kept, grad, camera, gaussians, convexes, torch.get_num_threads())
        if camera["camera"] is not None:
            limit = torch.finfo(torch.float32).max  # scales near the end of float32's range would give infinities here
            intrinsics = camera["camera"].clamp_(-limit, limit)
            if out[0] is not None:
                out[0][0, 0], out[0][1, 1], out[0][0, 2], out[0][1, 2] = intrinsics[:4]
            if out[1] is not None:
                out[1] = intrinsics[4:].reshape(3, 4)
        if out[2] is not None:
            out[2] = camera["background"].to(torch.float32)
        return None, *out
