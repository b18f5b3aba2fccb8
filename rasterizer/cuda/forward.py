"""The forward pass on the GPU: project the primitives, sort them by depth, list them by tile, blend."""

from __future__ import annotations

from collections.abc import Callable
from ctypes import c_int32, c_int64
from typing import Any, NamedTuple

import torch
from torch import Tensor

from . import capacity, programs
from .runtime import Launcher, Program, read_later
from .sort import sort, space
from .state import Inputs, State, looks_of

THREADS = 128  # threads per block in the kernels that use one thread per primitive; kProjectThreads in kept.cuh
COUNT_THREADS = 256  # kCountThreads in tiles.cu
MOST_PAIRS = 2**31 - 1
COUNTS, KEPT = 6, 4  # numbers in State.counts, padded, and which of them is kKept in records.cuh


def forward(launcher: Launcher, inputs: Inputs, keep: bool, deterministic: bool) -> tuple[dict[str, Tensor], State]:
    """The images (color, alpha, depth, extras) and the state. With `keep`, the state contains what `backward` needs.

    Primitives are kept, and the tiles' lists made, in the space that the last frames needed, and blended, before the host asks how much
    this frame needs: so the GPU has work while the host waits. What had too little is made again. Inside a CUDA graph, what is beyond the
    space is left out: primitives with the highest indices, and pairs of a tile and a primitive that are the furthest away.

    Raises MemoryError if there are more pairs than can be numbered, torch.OutOfMemoryError as torch does.
    """
    fixed = capacity.room_in_graph(inputs)
    if fixed is not None:
        kept = _keep(launcher, inputs, fixed)
        capacity.captured(inputs, fixed, kept.counts)
        state = _lists(launcher, inputs, kept, keep, deterministic, fixed.pairs)
        return _blend(launcher, inputs, state, keep), state
    likely = capacity.likely_room(inputs)
    room, known = likely or capacity.Room(inputs.n, inputs.m, 0), likely is not None  # whether lists are made before the pairs are counted
    kept, taken = _keep_and_count(launcher, inputs, room)
    while True:
        if known:
            state = _lists(launcher, inputs, kept, keep, deterministic, min(room.pairs, MOST_PAIRS))
            images = _blend(launcher, inputs, state, keep)
        used = capacity.Room(*taken())
        if used.pairs > MOST_PAIRS:
            raise MemoryError(
                f"{inputs.n + inputs.m} primitives cover {used.pairs:.3g} pairs of a tile and a primitive in this "
                f"{inputs.width} x {inputs.height} image, more than the {MOST_PAIRS} that can be numbered; render fewer or smaller "
                "primitives, or a smaller image"
            )
        if used.gaussians > room.gaussians or used.convexes > room.convexes:
            room, known = used, False  # of the pairs, only those of the primitives that were kept have been counted
            kept, taken = _keep_and_count(launcher, inputs, room)
            continue
        capacity.took(inputs, used)
        if known and used.pairs <= room.pairs:
            return images, state
        room, known = used, True


class _Kept(NamedTuple):
    """The projected primitives from front to back; see `State`, whose first five fields these are, too."""

    gaussians: Tensor
    convexes: Tensor
    counts: Tensor
    ids: Tensor
    slots: Tensor
    boxes: Tensor
    order: Tensor
    ends: Tensor
    visible: Tensor


def _keep_and_count(launcher: Launcher, inputs: Inputs, room: capacity.Room) -> tuple[_Kept, Callable[[], list[int]]]:
    """`_keep`, and a function that waits for the numbers of Gaussians, convexes and pairs that the frame needs."""
    kept = _keep(launcher, inputs, room)
    return kept, read_later(kept.counts[: len(room)])


def _keep(launcher: Launcher, inputs: Inputs, room: capacity.Room) -> _Kept:
    """Projects all primitives, and sorts those that may be visible by depth."""
    total, device = room.gaussians + room.convexes, inputs.device
    record_bytes = -(-(48 + 24 * inputs.points) // 16) * 16
    records = torch.empty(room.gaussians, 64, dtype=torch.uint8, device=device)
    convex_records = torch.empty(room.convexes, record_bytes, dtype=torch.uint8, device=device)
    depth = torch.empty(total, dtype=torch.float64, device=device)
    boxes = torch.empty(total, 4, dtype=torch.int16, device=device)
    ids = torch.empty(total, dtype=torch.int32, device=device)
    slots = torch.empty(inputs.n + inputs.m, dtype=torch.int32, device=device)
    visible = torch.empty(inputs.n + inputs.m, dtype=torch.uint8, device=device)
    blocks, count_blocks = [-(-number // THREADS) for number in (inputs.n, inputs.m)], -(-total // COUNT_THREADS)
    # All that starts at zero, which a single launch fills.
    parts = (COUNTS, 1 + blocks[0], 1 + blocks[1], space(total), 1 + count_blocks)
    counts, *work, to_sort, to_count = torch.zeros(sum(parts), dtype=torch.int64, device=device).split(parts)
    out = (ids, depth, boxes)
    g, c, n = inputs.gaussians, inputs.convexes, inputs.n
    view = (inputs.view.camera, c_int32(inputs.width), c_int32(inputs.height))
    channels, antialiased = c_int32(inputs.channels), inputs.view.antialiased
    if n:
        looks, degree = looks_of(g)
        shape = (c_int32(n), g.means, g.quats, g.scales, g.opacities, looks, inputs.extras(g), channels)
        to = (c_int32(room.gaussians), work[0], counts, slots, *out, visible, records)
        launcher.launch(programs.project_gaussians(degree, antialiased), "project_gaussians", blocks[0], THREADS, *view, *shape, *to)
    if inputs.m:
        looks, degree = looks_of(c)
        shape = (c_int32(inputs.m), c.points, c.tau, c.kappa, c.opacities, looks, inputs.extras(c), channels)
        to = (c_int32(room.convexes), work[1], counts, slots[n:], *out, visible[n:], convex_records)
        program = programs.project_convexes(inputs.points, degree, antialiased)
        launcher.launch(program, "project_convexes", blocks[1], THREADS, *view, *shape, *to)
    _, order = sort(launcher, depth.view(torch.int64), keep_keys=False, number=counts[KEPT:], workspace=to_sort)
    ends = torch.empty(total, dtype=torch.int64, device=device)
    kept = _Kept(records, convex_records, counts, ids, slots, boxes, order, ends, visible)
    launcher.launch(_tiles(inputs), "count_tiles", count_blocks, COUNT_THREADS, *_shapes(inputs, kept), ends, to_count)
    return kept


def _lists(launcher: Launcher, inputs: Inputs, kept: _Kept, keep: bool, deterministic: bool, room: int) -> State:
    """The lists of the tiles, with space for ``room`` pairs. Pairs beyond it are left out."""
    device, total = inputs.device, len(kept.order)
    room = room if total else 0  # no thread would fill it
    keys = torch.empty(room, dtype=torch.int16 if inputs.tiles < programs.SHORT_KEYS else torch.int32, device=device)
    primitives = torch.empty(room, dtype=torch.int32, device=device)
    out = (kept.ends, c_int64(room), keys, primitives)
    launcher.launch(_tiles(inputs), "write_pairs", -(-total // THREADS), THREADS, *_shapes(inputs, kept), *out)
    pair = None
    if deterministic:
        sorted_keys, pair = sort(launcher, keys)
        entries = primitives[pair]
    else:
        sorted_keys, entries = sort(launcher, keys, primitives)
    begins = torch.empty(inputs.tiles + 1, dtype=torch.int32, device=device)
    touched = torch.empty(room, dtype=torch.uint8, device=device) if keep else None
    tiles = (c_int64(room), sorted_keys, c_int32(inputs.tiles), begins, touched)
    launcher.launch(_tiles(inputs), "find_tiles", -(-(room + 1) // 256), 256, *tiles)
    lists = (kept.order, kept.ends) if deterministic else None
    return State(*kept[:5], begins, entries, pair, lists, kept.visible, touched)


def _tiles(inputs: Inputs) -> Program:
    return programs.tiles(inputs.points, 16 if inputs.tiles < programs.SHORT_KEYS else 32)


def _shapes(inputs: Inputs, kept: _Kept) -> tuple[Any, ...]:
    size = c_int32(inputs.width), c_int32(inputs.height)
    return kept.counts, kept.gaussians, kept.convexes, kept.boxes, *size, inputs.view.drawn, kept.order


def _blend(launcher: Launcher, inputs: Inputs, state: State, keep: bool) -> dict[str, Tensor]:
    height, width, device, channels = inputs.height, inputs.width, inputs.device, inputs.channels
    shapes = {"color": (height, width, 3), "alpha": (height, width), "depth": (height, width), "extras": (height, width, channels)}
    images = {name: torch.empty(shape, dtype=torch.float32, device=device) for name, shape in shapes.items()}
    if keep:
        state.transmittance = torch.empty(height, width, dtype=torch.float32, device=device)
        state.last = torch.empty(height, width, dtype=torch.int32, device=device)
    for first in range(0, max(channels, 1), programs.CHANNELS):
        some = min(channels - first, programs.CHANNELS)
        own = (images["color"], images["alpha"], images["depth"]) if first == 0 else (None, None, None)
        kept = (state.transmittance, state.last, state.touched) if first == 0 else (None, None, None)
        scene = (*primitives_of(inputs, state), c_int32(first), state.begins, state.entries)
        out = (*own, images["extras"] if channels else None, *kept, c_int32(inputs.n), state.visible)
        program = programs.blend_forward(inputs.points, some)
        size = (c_int32(width), c_int32(height), inputs.view.background)
        launcher.launch(program, "blend_forward", inputs.tiles, 128, *scene, *size, *out)
    return images


def primitives_of(inputs: Inputs, state: State) -> tuple[Tensor | c_int32 | None, ...]:
    """The primitives' arguments that both blending kernels share."""
    extras = inputs.extras(inputs.gaussians), inputs.extras(inputs.convexes)
    return state.gaussians, state.convexes, state.ids, *extras, state.counts, c_int32(inputs.channels)
