"""The optimiser on the parameters of Gaussians against torch's Adam, foreach and fused; with every row seen, and with a tenth of them."""

from __future__ import annotations

from collections.abc import Callable

import torch
from e4dgs.rasterizer.reference.compare import relative_l2
from e4dgs.scene.training.optimiser import RowAdam
from e4dgs.workflows.bench.rows import Bench, Check, Measured
from e4dgs.workflows.bench.timing import interleaved, ratio
from torch import Tensor

COUNT = 30_000
SHAPES = {"means": (3,), "quats": (4,), "log_scales": (3,), "opacity_logits": (), "sh_dc": (1, 3), "sh_rest": (15, 3)}  # 59 a Gaussian
RATE, BETAS, EPS = 1e-3, (0.9, 0.99), 1e-15
SHARES = (1.0, 0.1)


def measure(bench: Bench) -> Measured:
    n = bench.count(COUNT, 100)
    checks, table, numbers = [], [], {}
    for share in SHARES:
        gradients = gradients_of(n, share)
        times = interleaved(bench, {name: make(n, gradients)[0] for name, make in CONTENDERS.items()}, 2 * bench.repeats)
        name = "all rows" if share == 1 else f"{share:.0%} of the rows with a gradient"
        for peer in ("torch fused", "torch foreach"):
            value, note = ratio(times[peer], times["ours"])
            checks.append(Check(f"{name}, {peer}'s time over ours", value, note=note))
        numbers[name] = {contender: t.json() for contender, t in times.items()}
        table += [(f"{name}, {contender}", f"{1e3 * t.best:.2f}", f"{1e3 * t.median:.2f}") for contender, t in times.items()]
    gradients = gradients_of(n, 1.0)
    step, parameters = make_ours(n, gradients)
    for _ in range(STEPS):
        step()
    error = max(relative_l2(p - start, exact(start, g)) for p, start, g in zip(parameters, parameters_of(n), gradients))
    checks.append(Check(f"error of {STEPS} steps' change against float64", error, unit="", note="relative L2, the worst parameter"))
    return Measured(
        protocol=f"59 parameters each of {n:,} Gaussians, six tensors; {torch.get_num_threads()} threads",
        checks=checks,
        numbers=numbers,
        columns=("", "best ms", "median ms"),
        table=table,
    )


STEPS = 5


def parameters_of(n: int) -> list[Tensor]:
    generator = torch.Generator().manual_seed(8)
    return [torch.randn(n, *shape, generator=generator) for shape in SHAPES.values()]


def gradients_of(n: int, share: float) -> list[Tensor]:
    """Gradients like those of training: zero in rows that no pixel saw."""
    generator = torch.Generator().manual_seed(9)
    seen = torch.rand(n, generator=generator) < share
    found = [1e-4 * torch.randn(n, *shape, generator=generator) for shape in SHAPES.values()]
    return [g * seen.view(-1, *[1] * (g.dim() - 1)) for g in found]


def make_ours(n: int, gradients: list[Tensor]) -> tuple[Callable[[], None], list[Tensor]]:
    parameters = [p.requires_grad_() for p in parameters_of(n)]
    adam = RowAdam(dict(zip(SHAPES, parameters)), {name: lambda progress: RATE for name in SHAPES}, BETAS)

    def step() -> None:
        for p, g in zip(parameters, gradients):
            p.grad = g
        adam.step(0.0)

    return step, [p.detach() for p in parameters]


def make_torch(**kind: bool) -> Callable[[int, list[Tensor]], tuple[Callable[[], None], list[Tensor]]]:
    def make(n: int, gradients: list[Tensor]) -> tuple[Callable[[], None], list[Tensor]]:
        parameters = [p.requires_grad_() for p in parameters_of(n)]
        adam = torch.optim.Adam(parameters, lr=RATE, betas=BETAS, eps=EPS, **kind)

        def step() -> None:
            for p, g in zip(parameters, gradients):
                p.grad = g
            adam.step()
            adam.zero_grad(set_to_none=True)

        return step, [p.detach() for p in parameters]

    return make


CONTENDERS = {"ours": make_ours, "torch fused": make_torch(fused=True), "torch foreach": make_torch(foreach=True)}


def exact(start: Tensor, gradient: Tensor) -> Tensor:
    """What `STEPS` steps of Adam with this gradient change, in float64. The change is compared, not the value: it is what Adam computes."""
    g = gradient.double()
    change, mean, square = torch.zeros_like(g), torch.zeros_like(g), torch.zeros_like(g)
    for k in range(1, STEPS + 1):
        mean, square = BETAS[0] * mean + (1 - BETAS[0]) * g, BETAS[1] * square + (1 - BETAS[1]) * g * g
        change -= RATE * (mean / (1 - BETAS[0] ** k)) / ((square / (1 - BETAS[1] ** k)).sqrt() + EPS)
    # Parameters are float32: a change below their spacing is lost whoever computes it, so the truth is rounded like them.
    return (start.double() + change).float().double() - start.double()
