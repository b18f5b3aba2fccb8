"""Linear blend skinning: each position moves with its nearest nodes, by weights that fall off over the nodes' radii."""

from __future__ import annotations

import torch
from torch import Tensor

from ... import _kernels
from ...rotation import compose, unit_matrices
from .nodes import Nodes


def distances(first: Tensor, second: Tensor) -> Tensor:
    """[A, B] distances between the points ``first`` [A, D] and ``second`` [B, D]. Not by a matrix product, torch's choice for many points,
    which loses all digits of small distances far from the origin."""
    return torch.cdist(first, second, compute_mode="donot_use_mm_for_euclid_dist")


def nearest_nodes(points: Tensor, hyper: Tensor, nodes: Nodes, count: int) -> Tensor:
    """[N, count] int32 indices of the nodes with the largest weights at ``points`` [N, 3] with ``hyper`` [N, H], largest weight first.
    No gradients."""
    count = min(count, len(nodes.home))
    points, hyper, *home = (p.detach().contiguous() for p in (points, hyper, nodes.home, nodes.home_hyper, nodes.falloff))
    if points.device.type == "cpu" and points.dtype == torch.float32:
        link = torch.empty(len(points), count, dtype=torch.int32)
        _kernels.nearest_nodes(points, hyper, home, link, torch.get_num_threads())
        return link
    if points.is_cuda and points.dtype == torch.float32:
        from ....rasterizer.cuda.runtime import launcher_for
        from ...cuda.skinning import nearest_nodes as nearest_on_gpu

        return nearest_on_gpu(launcher_for(points.device), points, hyper, nodes, count)
    here, there = torch.cat([points, hyper], 1), torch.cat([home[0], home[1]], 1)
    return (distances(here, there).square() * home[2]).topk(count, largest=False).indices.int()


def skin(points: Tensor, quats: Tensor, hyper: Tensor, link: Tensor, nodes: Nodes) -> tuple[Tensor, Tensor]:
    """``points`` [N, 3] and ``quats`` [N, 4] (w x y z, any norm) as the nodes ``link`` [N, k] carry them: moved [N, 3] and turned [N, 4].

    A weight is exp(-falloff d^2), where d is the distance in space and ``hyper`` [N, H] together, divided by the sum over the k nodes.
    Gradients reach everything except ``link`` and ``nodes.home``; those of positions do not go through the weights. float32 on the CPU or
    on an NVIDIA GPU uses a kernel, anything else plain torch. Of these, only the CPU's looks whether the links are there.
    """
    if points.device.type == "cpu" and points.dtype == torch.float32:
        return _Skin.apply(points, quats, hyper, link, *nodes)
    if points.is_cuda and points.dtype == torch.float32:
        from ....rasterizer.cuda.runtime import launcher_for
        from ...cuda.skinning import skin as skin_on_gpu

        return skin_on_gpu(launcher_for(points.device), points, quats, hyper, link, nodes)
    return skin_reference(points, quats, hyper, link, nodes)


def skin_reference(points: Tensor, quats: Tensor, hyper: Tensor, link: Tensor, nodes: Nodes) -> tuple[Tensor, Tensor]:
    """`skin` in plain torch: the kernel's oracle in float64, and the implementation on other devices."""
    index = link.long()
    home = nodes.home.detach()[index]
    distance = (points.detach()[:, None] - home).square().sum(2) + (hyper[:, None] - nodes.home_hyper[index]).square().sum(2)
    weights = torch.softmax(-distance * nodes.falloff[index], 1)
    turns = nodes.turns[index]
    arms = (unit_matrices(nodes.turns)[index] @ (points[:, None] - home)[..., None])[..., 0]
    moved = (weights[..., None] * (arms + home + nodes.shifts[index])).sum(1)
    side = torch.where((turns * turns[:, :1]).sum(2, keepdim=True) < 0, -1.0, 1.0).to(turns)  # q and -q are one rotation
    blended = (weights[..., None] * side * turns).sum(1)
    return moved, compose(blended / blended.norm(dim=1, keepdim=True).clamp(min=1e-6), quats)


class _Skin(torch.autograd.Function):
    @staticmethod
    def forward(ctx, points: Tensor, quats: Tensor, hyper: Tensor, link: Tensor, *nodes: Tensor):  # type: ignore[override]
        given = [p.detach().contiguous() for p in (points, quats, hyper)]
        plain = [p.detach().contiguous() for p in nodes]
        link = link.contiguous()
        moved, turned = torch.empty_like(given[0]), torch.empty_like(given[1])
        _kernels.skin_forward(*given, link, plain, moved, turned, torch.get_num_threads())
        ctx.save_for_backward(*given, link, *plain)
        return moved, turned

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx, g_moved: Tensor, g_turned: Tensor):  # type: ignore[override]
        points, quats, hyper, link, *nodes = ctx.saved_tensors
        own = [torch.empty_like(p) for p in (points, quats, hyper)]
        of_nodes = [torch.empty_like(p) for p in nodes[1:]]
        grads = g_moved.contiguous(), g_turned.contiguous()
        _kernels.skin_backward(points, quats, hyper, link, nodes, *grads, *own, of_nodes, torch.get_num_threads())
        return *own, None, None, *of_nodes
