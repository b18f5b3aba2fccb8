"""Points that nodes carry, on the GPU: the search for the nearest nodes, and a torch.autograd.Function around `skinning.cu`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from ctypes import c_int32, c_int64
from typing import Any, Protocol

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from ...rasterizer.cuda.runtime import Launcher
from .inputs import check
from .programs import program

THREADS = 128
SUM_THREADS = 384  # as in sum_links.cu
MOST_LINKS, MOST_HYPER = 8, 4
ROW = 12  # numbers of a node's gradient: shift 3, falloff 1, turn 4, hyper coordinates up to 4


class Nodes(Protocol):
    """What is read of `scene.motion.skinning.Nodes`, which lies above this file."""

    @property
    def home(self) -> Tensor: ...
    @property
    def home_hyper(self) -> Tensor: ...
    @property
    def falloff(self) -> Tensor: ...
    def _asdict(self) -> dict[str, Tensor]: ...
    def __iter__(self) -> Iterator[Tensor]: ...


def nearest_nodes(launcher: Launcher, points: Tensor, hyper: Tensor, nodes: Nodes, count: int) -> Tensor:
    """`scene.motion.skinning.nearest_nodes`: [N, count] int32. float32 on the launcher's device; the call does not synchronise.

    Raises ValueError for other shapes or types, and whatever `Launcher.launch` raises.
    """
    given = {"points": points, "hyper": hyper, "home": nodes.home, "home_hyper": nodes.home_hyper, "falloff": nodes.falloff}
    count = min(count, len(nodes.home))
    _check(given, count)
    link = torch.empty(len(points), count, dtype=torch.int32, device=points.device)
    sizes, plain = (c_int32(len(points)), c_int32(len(nodes.home))), [p.detach().contiguous() for p in given.values()]
    search = program("nearest", links=count, hyper=hyper.shape[1])
    launcher.launch(search, "nearest_nodes", -(-len(points) // THREADS), THREADS, *sizes, *plain, link)
    return link


def skin(launcher: Launcher, points: Tensor, quats: Tensor, hyper: Tensor, link: Tensor, nodes: Nodes) -> tuple[Tensor, Tensor]:
    """`scene.motion.skinning.skin`: moved [N, 3] and turned [N, 4]. float32, and ``link`` [N, k] int32, on the launcher's device; the call
    does not synchronise. So it cannot see whether links are there: each must be one of the B nodes.

    Gradients of nodes are sums over points in no fixed order, unless `torch.use_deterministic_algorithms(True)` is set: then they are
    bit-equal from run to run, at the price of a sort of the links. Raises ValueError for other shapes or types, and whatever
    `Launcher.launch` raises.
    """
    if link.ndim != 2 or len(link) != len(points) or link.dtype != torch.int32:
        raise ValueError(f"link must be [N, k] int32, got {list(link.shape)} {link.dtype}")
    _check({"points": points, "quats": quats, "hyper": hyper, **nodes._asdict()}, link.shape[1])
    moved, turned = _Skin.apply(launcher, points, quats, hyper, link, *nodes)
    return moved, turned


class _Skin(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, launcher: Launcher, *given: Tensor) -> tuple[Tensor, Tensor]:
        points, quats, hyper, link, *_ = given = tuple(p.detach().contiguous() for p in given)
        moved, turned = torch.empty_like(points), torch.empty_like(quats)
        ctx.program = program("skinning", links=link.shape[1], hyper=hyper.shape[1])
        launcher.launch(ctx.program, "skin", -(-len(points) // THREADS), THREADS, c_int32(len(points)), *given, moved, turned)
        ctx.save_for_backward(*given)
        ctx.launcher = launcher
        ctx.set_materialize_grads(False)
        return moved, turned

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *grads: Tensor | None) -> tuple[Any, ...]:
        points, quats, hyper, link, home, *_ = given = ctx.saved_tensors
        n, nodes = len(points), len(home)
        own = [torch.empty_like(p) for p in (points, quats, hyper)]
        in_order = torch.are_deterministic_algorithms_enabled()
        sums = points.new_zeros(nodes, ROW)
        rows = points.new_empty(link.numel(), ROW) if in_order else None
        inputs = (c_int32(n), *given, *(None if g is None else g.contiguous() for g in grads))
        ctx.launcher.launch(ctx.program, "skin_backward", -(-n // THREADS), THREADS, *inputs, *own, sums, rows)
        if in_order:
            linked, order = torch.sort(link.view(-1), stable=True)
            ctx.launcher.launch(program("sum_links"), "sum_links", nodes, SUM_THREADS, c_int64(len(order)), linked, order, rows, sums)
        shifts, falloff, turns = sums[:, :3], sums[:, 3], sums[:, 4:8]
        home_hyper = sums[:, 8 : 8 + hyper.shape[1]].contiguous()  # a parameter; autograd warns of gradients laid out otherwise
        return None, *own, None, None, home_hyper, falloff, turns, shifts


def _check(given: Mapping[str, Tensor], links: int) -> None:
    """ValueError if these tensors, by name, are not of the shapes and the type that the kernels take."""
    n, nodes, coordinates = len(given["points"]), len(given["home"]), given["hyper"].shape[-1]
    if not (coordinates <= MOST_HYPER and 1 <= links <= MOST_LINKS and nodes):
        limits = f"hyper must be [N, 0 to {MOST_HYPER}] and link must be [N, 1 to {MOST_LINKS}], to at least one node"
        raise ValueError(f"{limits}; got {list(given['hyper'].shape)}, {links} links and {nodes} nodes")
    of_points = {"points": (n, 3), "quats": (n, 4), "hyper": (n, coordinates)}
    of_nodes = {"home": (nodes, 3), "home_hyper": (nodes, coordinates), "falloff": (nodes,), "turns": (nodes, 4), "shifts": (nodes, 3)}
    check({name: (tensor, (of_points | of_nodes)[name]) for name, tensor in given.items()})
