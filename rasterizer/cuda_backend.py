"""The CUDA backend: a torch.autograd.Function around the kernels. float32; sums in a fixed order if torch is set to be deterministic."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from .cuda.backward import backward
from .cuda.forward import forward
from .cuda.runtime import Launcher, launcher_for
from .cuda.state import Inputs, View, view_on
from .types import CONVEX_FIELDS, GAUSSIAN_FIELDS, IMAGES, Camera, Convexes, Frame, Gaussians

LEADING = 3  # K, cam_from_world and background come before the primitives' fields


def rasterize_cuda(
    camera: Camera,
    gaussians: Gaussians,
    convexes: Convexes,
    background: Tensor,
    antialiased: bool = False,
    tiles: Tensor | None = None,
) -> Frame:
    """Render with the CUDA kernels. Called by `rasterize`, which has checked the arguments and made them uniform.

    The primitives' tensors are contiguous float32 on one device; the extras of both kinds have the same width E. The camera and the
    background may be on the CPU, which avoids waiting for the device. Gradients are computed only for inputs that require them. With
    `torch.use_deterministic_algorithms(True)` they are bit-identical from run to run.

    Raises what `launcher_for` raises; MemoryError and torch.OutOfMemoryError if the frame does not fit.
    """
    device = gaussians.means.device
    view = view_on(device, camera, background, antialiased, tiles)
    tensors = [camera.K, camera.cam_from_world, background]
    tensors += [getattr(gaussians, name) for name in GAUSSIAN_FIELDS]
    tensors += [getattr(convexes, name) for name in CONVEX_FIELDS]
    return Frame(*_Rasterize.apply(launcher_for(device), view, *tensors))


class _Rasterize(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, launcher: Launcher, view: View, *tensors: Tensor | None) -> tuple[Tensor, ...]:
        inputs = _inputs(view, tensors)
        keep = any(ctx.needs_input_grad)
        deterministic = torch.are_deterministic_algorithms_enabled()
        try:
            images, state = forward(launcher, inputs, keep, deterministic)
        except torch.OutOfMemoryError as cause:
            raise torch.OutOfMemoryError(_what_to_lower(inputs, keep, cause)) from cause
        ctx.set_materialize_grads(False)
        if keep:
            ctx.launcher, ctx.view, ctx.state = launcher, view, state
            # Autograd checks versions: changing an input in place between forward and backward is an error, not a wrong gradient.
            ctx.save_for_backward(images["alpha"], images["depth"], *tensors)
        visible = state.visible.view(torch.bool)
        seen = visible[: inputs.n], visible[inputs.n :]
        ctx.mark_non_differentiable(*seen)
        return images["color"], images["alpha"], images["depth"], images["extras"], *seen

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *grads: Tensor | None) -> tuple[Any, ...]:
        alpha, depth, *tensors = ctx.saved_tensors
        inputs = _inputs(ctx.view, tensors)
        needs = dict(zip(_names(inputs), ctx.needs_input_grad[2:]))
        wanted = {name: bool(need) for name, need in needs.items() if name} | {"camera": needs["K"] or needs["cam_from_world"]}
        images = {"alpha": alpha, "depth": depth}
        incoming = {name: None if g is None else g.float().contiguous() for name, g in zip(IMAGES, grads)}
        try:
            found = backward(ctx.launcher, inputs, ctx.state, images, incoming, wanted)
        except torch.OutOfMemoryError as cause:
            raise torch.OutOfMemoryError(_what_to_lower(inputs, True, cause)) from cause
        if wanted["camera"]:
            limit = torch.finfo(torch.float32).max  # scales near the end of float32's range would give infinities here
            numbers = found["camera"].clamp(-limit, limit)
            fx, fy, cx, cy = numbers[:4].unbind()
            zero = torch.zeros_like(fx)
            found["K"] = torch.stack([fx, zero, cx, zero, fy, cy, zero, zero, zero]).reshape(3, 3)
            pose = numbers[4:].reshape(3, 4)
            found["cam_from_world"] = torch.cat([pose, torch.zeros_like(pose[:1])])
        out = [found.get(name) if need else None for name, need in needs.items()]
        out = [None if g is None else g.to(t.device, t.dtype) for g, t in zip(out, tensors)]
        return None, None, *out


def _names(inputs: Inputs) -> list[str]:
    """Names of the gradients, in the order of the tensors. A kind has either sh or colors; no gradient has the name of the other one."""
    names = ["K", "cam_from_world", "background"]
    for kind, owner, fields in (("gaussians", inputs.gaussians, GAUSSIAN_FIELDS), ("convexes", inputs.convexes, CONVEX_FIELDS)):
        for field in fields:
            given = field not in ("sh", "colors") or getattr(owner, field) is not None
            names.append(f"{kind}.{'looks' if field in ('sh', 'colors') and given else field}")
    return names


def _inputs(view: View, tensors: Any) -> Inputs:
    gaussians = Gaussians(*tensors[LEADING : LEADING + len(GAUSSIAN_FIELDS)])
    convexes = Convexes(*tensors[LEADING + len(GAUSSIAN_FIELDS) :])
    channels = gaussians.extras.shape[1] if gaussians.extras is not None else 0
    return Inputs(view, gaussians, convexes, channels)


def _what_to_lower(inputs: Inputs, keep: bool, cause: BaseException) -> str:
    gradients = ", or without gradients (torch.no_grad)" if keep else ""
    return (
        f"the GPU has no memory left to render {inputs.n} Gaussians and {inputs.m} convexes at {inputs.width} x {inputs.height}; "
        f"render a smaller image, fewer or smaller primitives{gradients}. {cause}"
    )
