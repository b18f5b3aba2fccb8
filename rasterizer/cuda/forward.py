"""The forward pass on the GPU: project the primitives, sort them by depth, list them by tile, blend."""

from __future__ import annotations

from ctypes import c_int32, c_int64

import torch
from torch import Tensor

from . import programs
from .runtime import Launcher
from .state import Inputs, State, looks_of

THREADS = 128  # threads per block in the kernels that use one thread per primitive
MOST_PAIRS = 2**31 - 1


def forward(
    launcher: Launcher, inputs: Inputs, keep: bool, deterministic: bool, room: int | None = None
) -> tuple[dict[str, Tensor], State]:
    """The images (color, alpha, depth, extras) and the state. With `keep`, the state contains what `backward` needs.

    room: number of (tile, primitive) pairs to allocate when waiting for the device is not allowed (inside a CUDA graph). Pairs beyond
        it, which are the furthest away, are left out. None: wait for the number and allocate exactly that many.

    Raises MemoryError if there are more pairs than can be numbered, torch.OutOfMemoryError as torch does.
    """
    state = _lists(launcher, inputs, deterministic, room)
    return _blend(launcher, inputs, state, keep), state


def _lists(launcher: Launcher, inputs: Inputs, deterministic: bool, room: int | None) -> State:
    n, m, device = inputs.n, inputs.m, inputs.device
    total, size = n + m, (c_int32(inputs.width), c_int32(inputs.height))
    records = torch.empty(n, 64, dtype=torch.uint8, device=device)
    record_bytes = -(-(48 + 24 * inputs.points) // 16) * 16
    convex_records = torch.empty(m, record_bytes, dtype=torch.uint8, device=device)
    depth = torch.empty(total, dtype=torch.float64, device=device)
    boxes = torch.empty(total, 4, dtype=torch.int16, device=device)
    _project(launcher, inputs, records, convex_records, depth, boxes)

    order = torch.sort(depth, stable=True).indices
    del depth
    tiles = programs.tiles(inputs.points, 16 if inputs.tiles < programs.SHORT_KEYS else 32)
    common = (c_int32(total), c_int32(n), records, convex_records, boxes, *size, inputs.drawn)
    counts = torch.empty(total, dtype=torch.int32, device=device)
    blocks = -(-total // THREADS)
    launcher.launch(tiles, "count_tiles", blocks, THREADS, *common, counts)
    ends = counts[order].cumsum(0)
    pairs = room if room is not None else int(ends[-1]) if total else 0
    if pairs > MOST_PAIRS:
        raise MemoryError(
            f"{total} primitives cover {pairs:.3g} pairs of a tile and a primitive in this {inputs.width} x {inputs.height} "
            f"image, more than the {MOST_PAIRS} that can be numbered; render fewer or smaller primitives, or a smaller image"
        )
    keys = torch.empty(pairs, dtype=torch.int16 if inputs.tiles < programs.SHORT_KEYS else torch.int32, device=device)
    primitives = torch.empty(pairs, dtype=torch.int32, device=device)
    if room is not None:  # keys that no pair fills sort behind all tiles
        keys.fill_(inputs.tiles)
        primitives.zero_()
    launcher.launch(tiles, "write_pairs", blocks, THREADS, *common, order, ends, c_int64(pairs), keys, primitives)
    keys, pair = torch.sort(keys, stable=True)
    entries = primitives[pair]
    begins = torch.empty(inputs.tiles + 1, dtype=torch.int32, device=device)
    launcher.launch(tiles, "find_tiles", -(-(pairs + 1) // 256), 256, c_int64(pairs), keys, c_int32(inputs.tiles), begins)
    visible = torch.zeros(total, dtype=torch.uint8, device=device)
    return State(records, convex_records, boxes, order, ends, begins, entries, pair if deterministic else None, visible)


def _project(launcher: Launcher, inputs: Inputs, records: Tensor, convex_records: Tensor, depth: Tensor, boxes: Tensor) -> None:
    g, c, n, m = inputs.gaussians, inputs.convexes, inputs.n, inputs.m
    view = (inputs.camera, c_int32(inputs.width), c_int32(inputs.height))
    channels = c_int32(inputs.channels)
    if n:
        looks, degree = looks_of(g)
        shape = (g.means, g.quats, g.scales, g.opacities, looks, inputs.extras(g), channels)
        program = programs.project_gaussians(degree, inputs.antialiased)
        launcher.launch(program, "project_gaussians", -(-n // THREADS), THREADS, *view, c_int32(n), *shape, records, depth, boxes)
    if m:
        looks, degree = looks_of(c)
        shape = (c.points, c.tau, c.kappa, c.opacities, looks, inputs.extras(c), channels)
        program = programs.project_convexes(inputs.points, degree, inputs.antialiased)
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
        size = (c_int32(width), c_int32(height), inputs.background)
        launcher.launch(program, "blend_forward", inputs.tiles, 128, *scene, *size, *out)
    return images


def primitives_of(inputs: Inputs, state: State) -> tuple[Tensor | c_int32 | None, ...]:
    """The primitives' arguments that both blending kernels share."""
    extras = inputs.extras(inputs.gaussians), inputs.extras(inputs.convexes)
    return state.gaussians, state.convexes, *extras, c_int32(inputs.n), c_int32(inputs.channels)
