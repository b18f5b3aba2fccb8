"""Trainings whose steps are replayed as CUDA graphs, and how their steps are compared with usual ones."""

from dataclasses import replace

import numpy as np
import torch
from e4dgs.scene.losses.held_depth import HeldDepth
from e4dgs.scene.losses.measured_depth import MeasuredDepth
from e4dgs.scene.losses.term import Measured
from e4dgs.scene.motion.lifetimes.lifetime import set_lifetime
from e4dgs.scene.motion.lifetimes.lifetimes import Lifetimes
from e4dgs.scene.motion.nodes.control_nodes import ControlNodes
from e4dgs.scene.motion.nodes.rigid_parts import RigidParts
from e4dgs.scene.motion.nodes.schedule import NODES
from e4dgs.scene.motion.phases import Phase
from e4dgs.scene.motion.static import Static
from e4dgs.scene.primitives import ConvexSet
from e4dgs.scene.training.control.density import measure_responsibility
from e4dgs.scene.training.control.splits import split
from e4dgs.scene.training.drawn_tiles import DrawnTiles
from e4dgs.scene.training.trainer import Trainer
from sliding_gaussians import SETTINGS, fresh, make_views

TOTAL, SIZE = 200, 48
PHASE = Phase("moving", TOTAL, move=True)
QUICK = SETTINGS.model_copy(update={"iterations": TOTAL, "flow_every": 8, "interval_weight": 1e-3, "dropout": 0.2, "affine": True})
KINDS = ("nodes", "nodes, turning", "lifetimes", "lifetimes, convexes", "static")


class Again:
    """`Recorded` on the CPU: the function is called again, and what it returns put in place of what it returned first."""

    def __init__(self, function, device, pool):
        self.function, self.results, self.frames = function, function(), []

    def replay(self):
        for old, new in zip(self.results, self.function(), strict=True):
            assert (old is None) == (new is None)
            if old is not None:
                old.copy_(new)


def half_moves(i):
    mask = np.zeros((SIZE, SIZE), np.uint8)
    mask[:, : SIZE // 3] = 255
    return mask


def begun(what, device="cpu"):
    """A training of "nodes" on one camera with alpha, or of "lifetimes" on a rig with everything that a rig has; "turning" adds a rigid
    part to the nodes, "convexes" some of these. "static": a rig in which nothing moves."""
    rig = "nodes" not in what
    views = replace(make_views(cameras=4 if rig else 1, times=8, size=SIZE), device=device)
    depth, flow, held = None, None, None
    if rig:
        views = replace(views, load_moving=half_moves)
        covered = [int(i) for i in views.train if views.camera[i] != 1]
        there = torch.full((SIZE, SIZE), 0.25, device=device)
        held = HeldDepth(dict.fromkeys(covered, torch.full((2, SIZE // 2, SIZE // 2), 0.3, device=device)), 4.0)
        depth = MeasuredDepth(dict.fromkeys(covered, there), 4.0, lambda i: torch.from_numpy(half_moves(i) > 0).to(device))

        def flow(i):
            return None if views.next[i] < 0 else (torch.full((SIZE // 2, SIZE // 2, 2), 0.1 * i), torch.ones(SIZE // 2, SIZE // 2))
    else:
        alpha = np.tile(np.linspace(128, 255, SIZE, dtype=np.uint8), (SIZE, 1))
        kept = np.full((SIZE, SIZE), 255, np.uint8)
        kept[: SIZE // 4, : SIZE // 4] = 0
        views = replace(views, load_alpha=lambda i: alpha, load_kept=lambda i: kept)
    model = fresh(views)
    gaussians = model.gaussians
    if what == "static":
        model.motion = Static()
        gaussians.dynamic.fill_(False)
    elif rig:
        model.motion = Lifetimes(8)
        set_lifetime(model.gaussians, torch.arange(len(gaussians)) % 8, 2.0)
        model.gaussians.dynamic = torch.arange(len(gaussians)) % 3 > 0
    else:
        model.motion = ControlNodes.over(gaussians.means.detach().numpy(), QUICK.seed)
    if "turning" in what:
        g = torch.Generator().manual_seed(1)
        part = RigidParts.none().joined(torch.zeros(3), 0.5, torch.randn(4, 4, generator=g), 0.1 * torch.randn(4, 3, generator=g))
        model.motion = model.motion.with_rigid_parts(part)
    if "convexes" in what:
        corners = gaussians.means.detach()[:5, None] + 0.1 * torch.randn(5, 6, 3, generator=torch.Generator().manual_seed(1))
        model.convexes = ConvexSet.from_points(corners.numpy(), np.full((5, 3), 0.5), model.sh_degree, opacity=0.5)
        if rig:
            set_lifetime(model.convexes, 3.0, 2.0)
    recipe = replace(Lifetimes.recipe if rig else NODES, interval=1e-3)
    measured = Measured(flow, depth, held)
    trainer = Trainer(model.to(device), views, [PHASE], QUICK, 400, recipe=recipe, measured=measured)
    assert trainer.objective.run.several == rig
    trainer.objective.drawn = DrawnTiles(views, 0, 100_000)
    trainer.objective.drawn.often = {0, 1}
    return trainer


def evaluated(trainer, evaluate, step):
    parameters = trainer.learned.optimiser.parameters()
    for p in parameters.values():
        p.grad = None
    i = int(trainer.views.train[step * 7 % len(trainer.views.train)])
    found = evaluate(trainer.model, i, step, PHASE, 1)
    found.backward()
    values = {
        "loss": found.loss.detach(),
        "image loss": found.image_loss,
        "color": found.color.detach(),
        "psnr": torch.tensor(found.psnr()),
    }
    for name, p in parameters.items():
        grad = p.grad
        assert grad is None or grad.shape == p.shape, name
        values[name] = torch.zeros_like(p) if grad is None else grad
    return {name: value.clone() for name, value in values.items()}


def agree(trainer, steps):
    for step in steps:
        want, got = evaluated(trainer, trainer.objective, step), evaluated(trainer, trainer.replayed, step)
        for name, value in want.items():
            assert (got[name] - value).norm() <= 1e-4 * value.norm() + 1e-7, (step, name)


def agree_in_other_numbers(trainer):
    """Usual and replayed steps with more and with fewer Gaussians than were captured. Returns how many graphs were made."""
    steps = [*range(61, 105), 112, 120, 128]  # at 100, links are searched again
    agree(trainer, 2 * steps)  # a kind of step that comes up once is not captured
    captures = trainer.replayed.graphs.captures
    before = trainer.model.gaussians
    some = torch.arange(10, device=before.device)
    trainer.learned.replace(*split(before, some), 100)
    agree(trainer, steps)
    assert len(trainer.model.gaussians) == len(before) + 10
    keep = torch.arange(len(before) - 5, device=before.device)
    trainer.learned.replace(trainer.model.gaussians.select(keep), keep, 101)
    trainer.model.gaussians.dynamic[:3] = trainer.model.gaussians.dynamic[:3].clone()  # another version of the same
    agree(trainer, steps)
    assert trainer.replayed.graphs.captures == captures, "there was room"
    assert not trainer.log.events
    return captures


def agree_on_responsibility(trainer):
    """Usual and replayed measurements, while primitives are added and removed and the scale changes."""
    measure, views = trainer.density._measure, trainer.views
    frames = [int(i) for i in views.train]
    for scale, some in ((1.0, 10), (1.0, 0), (1.0, 0), (0.5, 10), (0.5, 20), (0.5, 0), (1.0, 0)):
        model = trainer.model
        want, got = (f(model, views, frames[some % 3 :: 3], True, scale) for f in (measure_responsibility, measure))
        for name, value in vars(want).items():
            there = getattr(got, name)
            assert there.shape == value.shape and torch.equal(torch.isinf(there), torch.isinf(value)), name
            atol = 1e-4 if name == "varying_gaussians" else 1e-6  # the former is a difference of sums that may be nearly equal
            assert torch.allclose(there, value, rtol=1e-4, atol=atol), (name, scale, some)
        if some:
            chosen = torch.arange(some, device=model.device)
            trainer.learned.replace(*split(model.gaussians, chosen), 100)
    assert len(measure.graphs) == 2 and not trainer.log.events
