"""Times a whole training step on the GPU, from motion to optimiser, and rendering of the same model in motion."""

from __future__ import annotations

import torch

from ..rows import Bench, Check, Measured
from ..step.motions import is_rig, model_in_motion
from ..step.training import PERIOD, make_trainer, views_of
from ..timing import interleaved
from .gpu import ending, gpu_name, need_gpu

STEP_MS, FRAMES = 3.0, 1000.0


def measure(bench: Bench) -> Measured:
    need_gpu()
    views, masks, name = views_of(bench)
    motion = "lifetimes" if is_rig(views) else "nodes"
    model = model_in_motion(bench, views, masks, motion, 1.0).to("cuda")
    views.device = "cuda"
    _, period = make_trainer(model, views)
    camera, t = views.rasterizer_camera(int(views.train[0])), views.moment(int(views.train[0]))
    runs = {"step": ending(period, 1), "render": ending(lambda: model.render(camera, t, views.backdrop()), PERIOD)}
    period()  # kernels are compiled, and steps captured as graphs, before the warm-up
    times = interleaved(bench, runs)
    torch.cuda.synchronize()
    step_ms, frames = 1e3 * times["step"].median / PERIOD, PERIOD / times["render"].median
    return Measured(
        f"{name}, {len(model.gaussians):,} Gaussians, motion '{motion}', all of them moving, SH of degree {model.sh_degree}, "
        f"{views.width}x{views.height}; mean of {PERIOD} steps, in which every term of the loss comes up; {gpu_name()}",
        [Check("a step", step_ms, STEP_MS, unit="ms"), Check("frames a second, motion included", frames, FRAMES, "above", unit="")],
        {"steps_a_run": PERIOD, "times": {key: timing.json() for key, timing in times.items()}},
    )
