"""The backward pass on the GPU: from gradients of the images to gradients of primitives and camera."""

from __future__ import annotations

from ctypes import c_int32, c_int64

import torch
from torch import Tensor

from . import programs
from .forward import THREADS, primitives_of
from .runtime import Launcher
from .state import Inputs, State, looks_of

GAUSSIAN_SUMS = 10  # as in records.cuh
CONVEX_EDGES = 7
GAUSSIAN_GRADS, CONVEX_GRADS = ("means", "quats", "scales", "opacities", "looks"), ("points", "tau", "kappa", "opacities", "looks")


def backward(
    launcher: Launcher, inputs: Inputs, state: State, images: dict[str, Tensor], grads: dict[str, Tensor | None], wanted: dict[str, bool]
) -> dict[str, Tensor]:
    """The `wanted` gradients by name: "camera" [16] float64 (fx fy cx cy, then the 3x4 of cam_from_world), "background" [3], and
    "gaussians.means", ..., "convexes.looks", "convexes.extras", each in the shape of its input.

    images: alpha and depth from `forward`. grads: gradients of color, alpha, depth and extras, contiguous float32 or None.
    """
    out = _gradients(inputs, wanted)
    if wanted.get("background"):
        assert state.transmittance is not None
        color = grads["color"]
        lit = (
            torch.zeros(3, dtype=torch.float64, device=inputs.device)
            if color is None
            else (color.double() * state.transmittance[..., None]).sum((0, 1))
        )
        out["background"] = lit.float()
    sums = _sums(launcher, inputs, state, images, grads, out)
    rows = _backproject(launcher, inputs, state, sums, out, bool(wanted.get("camera")))
    if wanted.get("camera"):
        out["camera"] = rows.sum(0)
    return {name: value for name, value in out.items() if wanted.get(name)}


def _gradients(inputs: Inputs, wanted: dict[str, bool]) -> dict[str, Tensor]:
    """Space for the gradients. Those of extras, which are added to, start at zero; the kernels write every row of the others."""
    found = {}
    for name, kind in (("gaussians", inputs.gaussians), ("convexes", inputs.convexes)):
        fields = ("means", "quats", "scales", "opacities") if name == "gaussians" else ("points", "tau", "kappa", "opacities")
        values = {field: getattr(kind, field) for field in fields} | {"looks": looks_of(kind)[0], "extras": kind.extras}
        for field, value in values.items():
            if value is not None and (wanted.get(f"{name}.{field}") or field == "extras"):
                found[f"{name}.{field}"] = torch.zeros_like(value) if field == "extras" else torch.empty_like(value)
    return found


def _sums(
    launcher: Launcher, inputs: Inputs, state: State, images: dict[str, Tensor], grads: dict[str, Tensor | None], out: dict[str, Tensor]
) -> tuple[Tensor, Tensor]:
    """Sums over the pixels for each slot, [*, GAUSSIAN_SUMS] and [*, *]. Gradients of extras are written to `out`."""
    m, device, pairs, slots_in_all = inputs.m, inputs.device, state.entries.shape[0], len(state.ids)
    convex_sums = CONVEX_EDGES + 3 * inputs.points
    parts = [state.gaussians.shape[0] * GAUSSIAN_SUMS, state.convexes.shape[0] * convex_sums]
    gaussians, convexes = torch.zeros(sum(parts), dtype=torch.float32, device=device).split(parts)
    if not pairs:
        return gaussians, convexes
    with_extras = inputs.channels > 0 and grads["extras"] is not None
    size = (c_int32(inputs.width), c_int32(inputs.height))
    for first in range(0, inputs.channels if with_extras else 1, programs.CHANNELS):
        some = min(inputs.channels - first, programs.CHANNELS) if with_extras else 0
        color, alpha, depth = (grads["color"], grads["alpha"], grads["depth"]) if first == 0 else (None, None, None)
        program = programs.blend_backward(inputs.points, some, depth is not None)
        shape_sums = max(convex_sums if m else 0, GAUSSIAN_SUMS)
        slots = torch.zeros(pairs, shape_sums + some, dtype=torch.float32, device=device) if state.pair is not None else None
        to = (gaussians, convexes, out.get("gaussians.extras"), out.get("convexes.extras"))
        scene = (*primitives_of(inputs, state), c_int32(first), state.begins, state.entries, state.touched, *size, inputs.view.background)
        pixels = (state.transmittance, state.last, color, alpha, depth, grads["extras"], images["alpha"], images["depth"])
        launcher.launch(program, "blend_backward", inputs.tiles, 128, *scene, *pixels, *to, state.pair, slots)
        if slots is not None and state.lists is not None:
            blocks = -(-slots_in_all * slots.shape[1] // 256)
            lists = (state.counts, state.ids, *state.lists, c_int64(pairs), slots)
            launcher.launch(program, "sum_slots", blocks, 256, *lists, c_int32(inputs.channels), c_int32(first), *to)
    return gaussians, convexes


def _backproject(
    launcher: Launcher, inputs: Inputs, state: State, sums: tuple[Tensor, Tensor], out: dict[str, Tensor], camera: bool
) -> Tensor:
    """Writes the gradients into `out`. Returns the camera's gradient as rows [*, 16], still to be summed. Nothing is launched for a kind of
    which only the extras' gradients are wanted."""
    g, c = inputs.gaussians, inputs.convexes
    n, m = (
        count if camera or any(name in out for name in (f"{kind}.{field}" for field in fields)) else 0
        for count, kind, fields in ((inputs.n, "gaussians", GAUSSIAN_GRADS), (inputs.m, "convexes", CONVEX_GRADS))
    )
    blocks, convex_blocks = -(-n // THREADS), -(-m // THREADS)
    rows = torch.zeros(blocks + convex_blocks if camera else 0, 16, dtype=torch.float64, device=inputs.device)
    view = (inputs.view.camera, c_int32(inputs.width), c_int32(inputs.height))
    if n:
        looks, degree = looks_of(g)
        grads = [out.get(f"gaussians.{name}") for name in GAUSSIAN_GRADS]
        program = programs.backproject_gaussians(degree, camera, inputs.view.antialiased)
        shape = (c_int32(n), g.means, g.quats, g.scales, g.opacities, looks, state.gaussians, state.slots, state.visible, sums[0])
        launcher.launch(program, "backproject_gaussians", blocks, THREADS, *view, *shape, *grads, rows if camera else None)
    if m:
        looks, degree = looks_of(c)
        grads = [out.get(f"convexes.{name}") for name in CONVEX_GRADS]
        program = programs.backproject_convexes(inputs.points, degree, camera, inputs.view.antialiased)
        of = (state.convexes, state.slots[inputs.n :], state.visible[inputs.n :], sums[1])
        shape = (c_int32(m), c.points, c.tau, c.kappa, c.opacities, looks, *of)
        launcher.launch(program, "backproject_convexes", convex_blocks, THREADS, *view, *shape, *grads, rows[blocks:] if camera else None)
    return rows
