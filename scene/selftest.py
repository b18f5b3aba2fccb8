"""Checks that training on the GPU gives the same results as on the CPU on this machine. Run once before the GPU is used.

    python -m e4dgs.scene.selftest

First compares a small render (`rasterizer/cuda/selftest.py`), then a step of training with each kind of motion that has a loss of its own:
what it renders, its loss with every term, the gradients of all parameters, and Adam. Exit code 0, or 1 with one line about what is wrong.
"""

from __future__ import annotations

import sys
from functools import partial

import numpy as np
import torch
from torch import Tensor

from ..rasterizer.cuda import selftest
from ..rasterizer.cuda.programs import backproject_convexes, backproject_gaussians, needed, project_convexes
from ..rasterizer.cuda.runtime import Program, warm_up
from .cuda.programs import program
from .losses.term import Measured, Run
from .model import Model
from .motion.interface import Motion
from .motion.lifetimes.lifetime import set_lifetime
from .motion.lifetimes.lifetimes import Lifetimes
from .motion.nodes.control_nodes import ControlNodes
from .motion.phases import Phase
from .motion.planes.field import DeformationField
from .primitives import ConvexSet, GaussianSet
from .settings import TrainingSettings
from .training.control.learned_model import LearnedModel
from .training.objective import Objective
from .views import Views

WIDTH, HEIGHT = 40, 24
CAMERAS, TIMES = 2, 3
DISTANCE = 4.0  # world units from the cameras to the middle of the scene
DEGREES = {"planes": 2, "nodes": 1, "lifetimes": 1}  # of spherical harmonics, by the motions to try; the last two share programs
WEIGHTS = {"spread_weight": 0.3, "tv_weight": 0.3}  # of terms that are off or lost among the others by default
STEP, TOTAL = 80, 100  # every term of the loss is evaluated at this step of this many


def problem(device: str) -> str | None:
    """One line about what is wrong with rendering or training on this device, or None if nothing is."""
    try:
        warm_up(programs_used(), torch.device(device))
    except Exception as cause:  # any failure is the answer
        return f"the CUDA kernels cannot be compiled here: {str(cause).splitlines()[0] if str(cause) else type(cause).__name__}"
    found = selftest.problem(device)
    for motion in DEGREES:
        found = found or selftest.disagreement(partial(_step, motion, "cpu"), partial(_step, motion, device))
    return found


def programs_used() -> list[Program]:
    """The programs of these checks. Compiled together, they take less time than one after another as they are met."""
    plain = needed(6, -1, 0, True), needed(6, 1, 0, True), needed(6, 2, 2, True), needed(6, -1, 2)
    fading = needed(6, 1, 2, True, antialiased=True), needed(6, -1, 2, antialiased=True)
    found = {one for some in (*plain, *fading) for one in some}
    found -= {project_convexes(6, 1), backproject_convexes(6, 1, False)}  # there, convexes have colours of their own
    # Of flow, only the extras have gradients.
    found -= {backproject_gaussians(-1, False), backproject_gaussians(-1, False, True), backproject_convexes(6, -1, False, True)}
    features = {"field": {"channels": 16, "levels": 2}, "field_backward": {"channels": 16, "levels": 2, "lines": 576}}
    features |= {name: {"links": 4, "hyper": 2} for name in ("nearest", "skinning")}
    features |= {name: {} for name in ("adam", "displace", "lives", "looks", "photometric", "smoothness")}
    return [*found, *(program(name, **of) for name, of in features.items())]


def _step(motion: str, device: str) -> dict[str, Tensor]:
    """What a step of training computes, by names for people."""
    settings = TrainingSettings.model_validate({"sh_degree": DEGREES[motion], **WEIGHTS})
    model = _model(motion).to(device)
    recipe = model.motion.recipe
    objective = Objective(Run(_views(device), settings, recipe, DISTANCE, motion == "planes", TOTAL, 0, Measured(_measured_flow)))
    judged = objective(model, 1, STEP, Phase("all", TOTAL), DEGREES[motion])
    judged.loss.backward()  # type: ignore[no-untyped-call]
    optimiser = LearnedModel(model, settings, DISTANCE, 1.0).optimiser
    parameters = optimiser.parameters()
    found = {"the loss": judged.loss.detach(), "the render": judged.color.detach()}
    found |= {f"the gradient of {name}": p.grad for name, p in parameters.items() if p.grad is not None}
    before = {name: p.detach().clone() for name, p in parameters.items()}
    g = torch.Generator().manual_seed(2)
    # The first steps of Adam follow the sign of the gradient. Where it is nearly zero, rounding decides the sign. So all get the same one.
    for _ in range(2):
        for p in parameters.values():
            seen = torch.rand(p.shape[:1], generator=g) < 0.7  # the other rows have no gradient and stay
            p.grad = (torch.randn(p.shape, generator=g) * seen.view(-1, *[1] * (p.ndim - 1))).to(device)
        optimiser.step(0.0)
    found |= {f"the step of {name}": p.detach() - before[name] for name, p in parameters.items()}
    return found | {f"the optimiser's {name}": moment for name, moment in optimiser.state().items()}


def _model(motion: str) -> Model:
    """A small model in motion, on the CPU."""
    rng, g = np.random.default_rng(1), torch.Generator().manual_seed(1)
    degree = DEGREES[motion]
    gaussians = GaussianSet.from_points(rng.uniform(-1, 1, (60, 3)), rng.random((60, 3)), degree, opacity=0.5, max_scale=0.3)
    corners = rng.uniform(-0.9, 0.9, (6, 1, 3)) + rng.uniform(-0.3, 0.3, (6, 6, 3))
    convexes = ConvexSet.from_points(corners, rng.random((6, 3)), degree, opacity=0.5)
    ends = torch.full((3,), -1.2), torch.full((3,), 1.2)
    moving: Motion = DeformationField(*ends, TIMES)
    if motion == "nodes":
        moving = ControlNodes(torch.tensor(rng.uniform(-1, 1, (24, 3))), torch.zeros(3), 1.0, 1.0)
    if motion == "lifetimes":
        moving = Lifetimes(TIMES)
        for kind in (gaussians, convexes):
            set_lifetime(kind, (TIMES - 1) * torch.rand(len(kind), generator=g), 1.0)
            kind.dynamic[::4] = False
    with torch.no_grad():  # motions start at rest, where most gradients are zero; of a ball, every turn looks the same
        shapes = [gaussians.parameters["log_scales"], gaussians.parameters["sh_rest"]]
        drifts = [kind.parameters[name] for kind in (gaussians, convexes) for name in ("velocities", "spins") if motion == "lifetimes"]
        for amount, parameters in ((0.03, [*moving.parameters(), *drifts]), (0.3, shapes)):
            for p in parameters:
                p.add_(amount * torch.randn(p.shape, generator=g))
    return Model(gaussians, convexes, moving, degree, antialiased=motion != "planes")  # both modes are tried


def _views(device: str) -> Views:
    """Two cameras that see three times, with pictures of noise."""
    count = CAMERAS * TIMES
    K = np.array([[WIDTH, 0, WIDTH / 2], [0, WIDTH, HEIGHT / 2], [0, 0, 1.0]])
    poses = np.repeat(np.eye(4)[None], count, 0)
    poses[:, 2, 3] = DISTANCE
    poses[TIMES:, 0, 3] = 0.5
    following = np.array([i + 1 if (i + 1) % TIMES else -1 for i in range(count)])
    pictures = np.random.default_rng(3).integers(0, 256, (count, HEIGHT, WIDTH, 3), np.uint8)
    return Views(
        np.repeat(K[None], count, 0), poses, np.tile(np.linspace(0, 1, TIMES), CAMERAS), np.repeat(np.arange(CAMERAS), TIMES), following,
        np.arange(count), WIDTH, HEIGHT, lambda i: pictures[i], background=(0.2, 0.3, 0.4), device=device,
    )  # fmt: skip


def _measured_flow(i: int) -> tuple[Tensor, Tensor]:
    """A flow of one pixel to the right, everywhere."""
    size = HEIGHT // 2, WIDTH // 2
    return torch.tensor([1.0, 0.0]).expand(*size, 2).clone(), torch.ones(size)


if __name__ == "__main__":
    found = problem("cuda")
    print(found or "the CUDA kernels agree with the CPU's")
    sys.exit(found is not None)
