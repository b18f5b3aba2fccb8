"""The forward pass on the GPU: project the primitives, sort them by depth, list them by tile, blend."""

from __future__ import annotations

from ctypes import c_int32, c_int64
from typing import Any, NamedTuple

import torch
from torch import Tensor

from . import capacity, programs
from .runtime import Launcher, Program, read_later
from .sort import sort
from .state import Inputs, State, looks_of

THREADS = 128  # threads per block in the kernels that use one thread per primitive
COUNT_THREADS = 256  # kCountThreads in tiles.cu
MOST_PAIRS = 2**31 - 1


def forward(launcher: Launcher, inputs: Inputs, keep: bool, deterministic: bool) -> tuple[dict[str, Tensor], State]:
    """The images (color, alpha, depth, extras) and the state. With `keep`, the state contains what `backward` needs.

    The lists of the tiles are made in the space that the last frames needed, and blended, before the host asks how much this frame needs:
    so the GPU has work while the host waits. If it was too little, lists and images are made again. Inside a CUDA graph, pairs of a tile
    and a primitive beyond the space, which are the furthest away, are left out.

    Raises MemoryError if there are more pairs than can be numbered, torch.OutOfMemoryError as torch does.
    """
    sorted_ = _sort(launcher, inputs)
    room = capacity.room_in_graph(inputs)
    if room is not None:
        capacity.captured(inputs, room, sorted_.ends)
        state = _lists(launcher, inputs, sorted_, deterministic, room)
        return _blend(launcher, inputs, state, keep), state
    needed, room = read_later(sorted_.ends[-1:]) if inputs.n + inputs.m else lambda: 0, capacity.likely_room(inputs)
    if room is not None:
        state = _lists(launcher, inputs, sorted_, deterministic, min(room, MOST_PAIRS))
        images = _blend(launcher, inputs, state, keep)
    pairs = needed()
    if pairs > MOST_PAIRS:
        raise MemoryError(
            f"{inputs.n + inputs.m} primitives cover {pairs:.3g} pairs of a tile and a primitive in this {inputs.width} x {inputs.height} "
            f"image, more than the {MOST_PAIRS} that can be numbered; render fewer or smaller primitives, or a smaller image"
        )
    capacity.took(inputs, pairs)
    if room is None or pairs > room:
        state = _lists(launcher, inputs, sorted_, deterministic, pairs)
        images = _blend(launcher, inputs, state, keep)
    return images, state


class _Sorted(NamedTuple):
    """The projected primitives from front to back; see `State`."""

    gaussians: Tensor
    convexes: Tensor
    boxes: Tensor
    order: Tensor
    ends: Tensor


def _sort(launcher: Launcher, inputs: Inputs) -> _Sorted:
    n, m, device = inputs.n, inputs.m, inputs.device
    records = torch.empty(n, 64, dtype=torch.uint8, device=device)
    record_bytes = -(-(48 + 24 * inputs.points) // 16) * 16
    convex_records = torch.empty(m, record_bytes, dtype=torch.uint8, device=device)
    depth = torch.empty(n + m, dtype=torch.float64, device=device)
    boxes = torch.empty(n + m, 4, dtype=torch.int16, device=device)
    _project(launcher, inputs, records, convex_records, depth, boxes)
    _, order = sort(launcher, depth.view(torch.int64), keep_keys=False)
    del depth
    ends = torch.empty(n + m, dtype=torch.int64, device=device)
    blocks = -(-(n + m) // COUNT_THREADS)
    workspace = torch.zeros(1 + blocks, dtype=torch.int64, device=device)
    common = _shapes(inputs, records, convex_records, boxes)
    launcher.launch(_tiles(inputs), "count_tiles", blocks, COUNT_THREADS, *common, order, ends, workspace)
    return _Sorted(records, convex_records, boxes, order, ends)


def _lists(launcher: Launcher, inputs: Inputs, sorted_: _Sorted, deterministic: bool, room: int) -> State:
    """The lists of the tiles, with space for ``room`` pairs. Pairs beyond it are left out."""
    device, total = inputs.device, inputs.n + inputs.m
    room = room if total else 0  # no thread would fill it
    keys = torch.empty(room, dtype=torch.int16 if inputs.tiles < programs.SHORT_KEYS else torch.int32, device=device)
    primitives = torch.empty(room, dtype=torch.int32, device=device)
    common = (*_shapes(inputs, sorted_.gaussians, sorted_.convexes, sorted_.boxes), sorted_.order)
    out = (sorted_.ends, c_int64(room), keys, primitives)
    launcher.launch(_tiles(inputs), "write_pairs", -(-total // THREADS), THREADS, *common, *out)
    pair = None
    if deterministic:
        sorted_keys, pair = sort(launcher, keys)
        entries = primitives[pair]
    else:
        sorted_keys, entries = sort(launcher, keys, primitives)
    begins = torch.empty(inputs.tiles + 1, dtype=torch.int32, device=device)
    launcher.launch(_tiles(inputs), "find_tiles", -(-(room + 1) // 256), 256, c_int64(room), sorted_keys, c_int32(inputs.tiles), begins)
    visible = torch.zeros(total, dtype=torch.uint8, device=device)
    return State(*sorted_, begins, entries, pair, visible)


def _tiles(inputs: Inputs) -> Program:
    return programs.tiles(inputs.points, 16 if inputs.tiles < programs.SHORT_KEYS else 32)


def _shapes(inputs: Inputs, records: Tensor, convex_records: Tensor, boxes: Tensor) -> tuple[Any, ...]:
    size = c_int32(inputs.width), c_int32(inputs.height)
    return c_int32(inputs.n + inputs.m), c_int32(inputs.n), records, convex_records, boxes, *size, inputs.view.drawn


def _project(launcher: Launcher, inputs: Inputs, records: Tensor, convex_records: Tensor, depth: Tensor, boxes: Tensor) -> None:
    g, c, n, m = inputs.gaussians, inputs.convexes, inputs.n, inputs.m
    view = (inputs.view.camera, c_int32(inputs.width), c_int32(inputs.height))
    channels = c_int32(inputs.channels)
    if n:
        looks, degree = looks_of(g)
        shape = (g.means, g.quats, g.scales, g.opacities, looks, inputs.extras(g), channels)
        program = programs.project_gaussians(degree, inputs.view.antialiased)
        launcher.launch(program, "project_gaussians", -(-n // THREADS), THREADS, *view, c_int32(n), *shape, records, depth, boxes)
    if m:
        looks, degree = looks_of(c)
        shape = (c.points, c.tau, c.kappa, c.opacities, looks, inputs.extras(c), channels)
        program = programs.project_convexes(inputs.points, degree, inputs.view.antialiased)
        out = (convex_records, depth[n:], boxes[n:])
        launcher.launch(program, "project_convexes", -(-m // THREADS), THREADS, *view, c_int32(m), *shape, *out)


def _blend(launcher: Launcher, inputs: Inputs, state: State, keep: bool) -> dict[str, Tensor]:
    height, width, device, channels = inputs.height, inputs.width, inputs.device, inputs.channels
    shapes = {"color": (height, width, 3), "alpha": (height, width), "depth": (height, width), "extras": (height, width, channels)}
    images = {name: torch.empty(shape, dtype=torch.float32, device=device) for name, shape in shapes.items()}
    if keep:
        state.touched = torch.zeros(state.entries.shape[0], dtype=torch.uint8, device=device)
        state.transmittance = torch.empty(height, width, dtype=torch.float32, device=device)
        state.last = torch.empty(height, width, dtype=torch.int32, device=device)
    for first in range(0, max(channels, 1), programs.CHANNELS):
        some = min(channels - first, programs.CHANNELS)
        own = (images["color"], images["alpha"], images["depth"]) if first == 0 else (None, None, None)
        kept = (state.transmittance, state.last, state.touched) if first == 0 else (None, None, None)
        scene = (*primitives_of(inputs, state), c_int32(first), state.begins, state.entries)
        out = (*own, images["extras"] if channels else None, *kept, state.visible)
        program = programs.blend_forward(inputs.points, some)
        size = (c_int32(width), c_int32(height), inputs.view.background)
        launcher.launch(program, "blend_forward", inputs.tiles, 128, *scene, *size, *out)
    return images


def primitives_of(inputs: Inputs, state: State) -> tuple[Tensor | c_int32 | None, ...]:
    """The primitives' arguments that both blending kernels share."""
    extras = inputs.extras(inputs.gaussians), inputs.extras(inputs.convexes)
    return state.gaussians, state.convexes, *extras, c_int32(inputs.n), c_int32(inputs.channels)
