"""The deformation field, forward + backward, against its composition of torch operations, and both against float64."""

from __future__ import annotations

from collections.abc import Callable
from copy import deepcopy

import torch
from e4dgs.rasterizer.reference.compare import relative_l2
from e4dgs.scene.motion.planes.displacement import Displacement
from e4dgs.scene.motion.planes.field import DeformationField
from e4dgs.workflows.bench.rows import Bench, Check, Measured
from e4dgs.workflows.bench.timing import Timing, interleaved, ratio
from torch import Tensor

from ..curves import Curve, Plotted
from ..peers.field import Lookup, TorchField

POINTS, TIMES, RESOLUTIONS = 30_000, 50, (16, 32)
CHANNELS = (16, 32)
BAR, ERROR_BAR = 8.0, 1e-5
TIME = 0.37
ROUNDED = (torch.float16, torch.bfloat16)
KINK = 1e-5  # a hidden unit whose input is nearer to zero than this may be on either side of its kink in float32
LOOKUPS: tuple[Lookup, ...] = ("grid_sample", "gather")


def measure(bench: Bench) -> Measured:
    n = bench.count(POINTS, 64)
    checks: list[Check] = []
    curves: list[Curve] = []
    numbers: dict[str, object] = {}
    table: list[tuple[str, ...]] = []
    for channels in CHANNELS:
        field, rest = trained_field(channels), torch.rand(n, 3, generator=torch.Generator().manual_seed(5)) * 2 - 1
        peers = {lookup: TorchField(field.state_dict(), lookup=lookup) for lookup in LOOKUPS}
        weights = outer_gradients(field, rest)
        runs = {"ours": pass_over(field, rest, weights)} | {name: pass_over(peer, rest, weights) for name, peer in peers.items()}
        times = interleaved(bench, runs)
        fastest = min(LOOKUPS, key=lambda name: times[name].best)
        value, note = ratio(times[fastest], times["ours"])
        checks.append(
            Check(f"{channels} channels, torch's time over ours", value, BAR, "above", note=f"{note}; the faster look-up, {fastest}")
        )
        truth = outcome(TorchField(field.state_dict(), torch.float64), rest, weights)
        errors = {"ours": errors_of(outcome(field, rest, weights), truth)}
        errors |= {name: errors_of(outcome(peer, rest, weights), truth) for name, peer in peers.items()}
        for dtype in ROUNDED:
            errors[f"ours, planes rounded to {str(dtype).removeprefix('torch.')}"] = errors_of(
                outcome(rounded(field, dtype), rest, weights), truth
            )
        worst = max(errors["ours"], key=lambda name: errors["ours"][name])
        note = f"{worst}; of torch's composition {max(errors[fastest].values()):.1e}"
        checks.append(Check(f"{channels} channels, largest error against float64", errors["ours"][worst], ERROR_BAR, unit="", note=note))
        numbers[f"C = {channels}"] = {"times": {name: t.json() for name, t in times.items()}, "errors": errors}
        # The kernel reads float32 whatever the planes were rounded to: the error alone speaks, and against fewer digits.
        times |= {name: times["ours"] for name in errors if name not in times}
        for name, timing in times.items():
            table.append(_cells(f"{channels} channels, {name}", timing, errors[name]))
            curves.append(
                Curve(
                    "field",
                    name,
                    [1e3 * timing.best],
                    [max(errors[name].values())],
                    "ms",
                    "largest relative error",
                    [f"C = {channels}"],
                )
            )
    return Plotted(
        protocol=f"{n:,} points, levels of {' and '.join(map(str, RESOLUTIONS))}, {TIMES} times, MLP of width 64, forward + backward to "
        f"every parameter; errors are relative L2 of each output and each gradient; {torch.get_num_threads()} threads",
        checks=checks,
        numbers=numbers,
        curves=curves,
        columns=("", "best ms", "median ms", "worst output", "worst gradient"),
        table=table,
    )


def trained_field(channels: int) -> DeformationField:
    """A field whose time planes and heads are no longer as they begin (ones and zeros, which would hide most errors)."""
    field = DeformationField(torch.full((3,), -1.0), torch.full((3,), 1.0), TIMES, RESOLUTIONS, channels, 64, seed=3)
    generator = torch.Generator().manual_seed(4)
    with torch.no_grad():
        for plane in field.planes.time:
            plane += 0.2 * torch.randn(plane.shape, generator=generator)
        field.head.weight += 0.05 * torch.randn(field.head.weight.shape, generator=generator)
    return field


def rounded(field: DeformationField, dtype: torch.dtype) -> DeformationField:
    """A copy whose planes hold only numbers of ``dtype``."""
    copy = deepcopy(field)
    with torch.no_grad():
        for plane in (*copy.planes.space, *copy.planes.time):
            plane.copy_(plane.to(dtype))
    return copy


@torch.no_grad()
def outer_gradients(field: DeformationField, rest: Tensor) -> Displacement:
    """Random gradients of dx, dr, ds; zero at points where rounding may decide on which side of its kink a hidden unit is."""
    exact = TorchField(field.state_dict(), torch.float64)
    first = exact.trunk[0](exact.inputs(rest.double(), TIME))
    second = exact.trunk[2](exact.trunk[1](first))
    decided = (torch.cat([first, second], 1).abs() < KINK).any(1)
    generator = torch.Generator().manual_seed(6)
    weights = [torch.randn(len(rest), width, generator=generator) for width in (3, 4, 3)]
    return Displacement(*(w * ~decided[:, None] for w in weights))


def pass_over(field: torch.nn.Module, rest: Tensor, weights: Displacement) -> Callable[[], None]:
    """Forward and backward once, from no gradients to gradients of every parameter."""
    parameters = list(field.parameters())

    def run() -> None:
        for p in parameters:
            p.grad = None
        torch.autograd.backward(list(field(rest, TIME)), list(weights))

    return run


def outcome(field: DeformationField | TorchField, rest: Tensor, weights: Displacement) -> dict[str, Tensor]:
    """Outputs and gradients by name, after one pass in the field's own precision."""
    dtype = field.low.dtype
    moved = field(rest.to(dtype), TIME)
    for p in field.parameters():
        p.grad = None
    torch.autograd.backward(list(moved), [w.to(dtype) for w in weights])
    if isinstance(field, TorchField):
        gradients = field.gradients()
    else:
        gradients = {name: p.grad for name, p in field.named_parameters() if p.grad is not None}
    found = {f"gradient of {name}": grad.clone() for name, grad in gradients.items()}
    return {name: value.detach() for name, value in zip(moved._fields, moved)} | found


def errors_of(got: dict[str, Tensor], want: dict[str, Tensor]) -> dict[str, float]:
    """Relative L2 by name; every name of ``want`` must be there."""
    return {name: relative_l2(got[name], value) for name, value in want.items()}


def _cells(name: str, timing: Timing, errors: dict[str, float]) -> tuple[str, ...]:
    worst = {kind: max(v for k, v in errors.items() if k.startswith("gradient") == kind) for kind in (False, True)}
    return (name, f"{1e3 * timing.best:.2f}", f"{1e3 * timing.median:.2f}", f"{worst[False]:.1e}", f"{worst[True]:.1e}")
