"""A whole training step against the same step composed of torch operations and the torch rasterizer."""

from __future__ import annotations

import torch
from e4dgs.rasterizer.reference.compare import relative_l2
from e4dgs.workflows.bench.rows import Bench, Check, Measured
from e4dgs.workflows.bench.step.training import PERIOD, make_model, make_trainer, views_of
from e4dgs.workflows.bench.timing import interleaved, ratio

from ..peers.step import composed_of_torch, copy_of, torch_kernels, with_torch_adam

BAR = 10.0


def measure(bench: Bench) -> Measured:
    views, masks, name = views_of(bench)
    model = make_model(bench, views, masks)
    peer = composed_of_torch(copy_of(model))
    # Both render the first view before either has learned anything: the same image, or the times mean nothing.
    camera, t = views.rasterizer_camera(int(views.train[0])), float(views.time[views.train[0]])
    with torch.no_grad():
        difference = _difference(model.render(camera, t).color, peer, camera, t)
    _, period = make_trainer(model, views)
    theirs, their_period = make_trainer(peer, views)
    with_torch_adam(theirs)

    def torch_period() -> None:
        with torch_kernels():
            their_period()

    times = interleaved(bench, {"ours": period, "torch": torch_period})
    value, note = ratio(times["torch"], times["ours"])
    return Measured(
        protocol=f"{name}, {len(model.gaussians.means):,} Gaussians with SH of degree {model.sh_degree}, {views.width}x{views.height}; "
        f"mean of {PERIOD} steps, in which every term of the loss comes up; {torch.get_num_threads()} threads",
        checks=[
            Check("torch's time over ours", value, BAR, "above", note=note),
            Check("relative difference of the two images before the first step", difference, unit="", note="L2"),
        ],
        numbers={"steps_a_run": PERIOD, "times": {name: t.json() for name, t in times.items()}},
        columns=("", "best ms a step", "median ms a step", "runs"),
        table=[(name, f"{1e3 * t.best / PERIOD:.1f}", f"{1e3 * t.median / PERIOD:.1f}", str(len(t.runs))) for name, t in times.items()],
    )


def _difference(image: torch.Tensor, peer, camera, t: float) -> float:
    from ..peers.rasterizer import rasterize_torch

    gaussians, _ = peer.at(t, camera)
    return relative_l2(rasterize_torch(camera, gaussians).color, image)
