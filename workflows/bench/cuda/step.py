"""Times a whole training step on the GPU, from field to optimiser, and rendering of the same model with its deformation."""

from __future__ import annotations

import torch

from ..rows import Bench, Check, Measured
from ..step.training import PERIOD, make_model, make_trainer, views_of
from ..timing import interleaved
from .gpu import ending, gpu_name, need_gpu

STEP_MS, FRAMES = 3.0, 1000.0


def measure(bench: Bench) -> Measured:
    need_gpu()
    views, masks, name = views_of(bench)
    model = make_model(bench, views, masks).to("cuda")
    views.device = "cuda"
    _, period = make_trainer(model, views)
    camera, t = views.rasterizer_camera(int(views.train[0])), float(views.time[views.train[0]])
    background = torch.tensor(views.background)
    runs = {"step": ending(period, 1), "render": ending(lambda: model.render(camera, t, background), PERIOD)}
    times = interleaved(bench, runs)
    step_ms, frames = 1e3 * times["step"].median / PERIOD, PERIOD / times["render"].median
    return Measured(
        f"{name}, {len(model.gaussians):,} Gaussians, all of them moving, SH of degree {model.sh_degree}, {views.width}x{views.height}; "
        f"mean of {PERIOD} steps, in which every term of the loss comes up; {gpu_name()}",
        [Check("a step", step_ms, STEP_MS, unit="ms"), Check("frames a second, deformation included", frames, FRAMES, "above", unit="")],
        {"steps_a_run": PERIOD, "times": {key: timing.json() for key, timing in times.items()}},
    )
