"""What a CUDA graph of a step reads, on the CPU: one frame in place of the views, and a twin of the model with leaves of its own."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from e4dgs.scene.cuda.leaves import own_leaves
from e4dgs.scene.motion.rigid_parts import RigidParts
from e4dgs.scene.training.recipe import NODES
from e4dgs.scene.training.replayed.one_view import OneView
from e4dgs.scene.training.schedule import Phase
from e4dgs.scene.training.trainer import Trainer
from e4dgs.stages.training.motions import make_nodes
from sliding_gaussians import SETTINGS, SIZE, fresh, make_views

TOTAL = 200
QUICK = SETTINGS.model_copy(update={"iterations": TOTAL, "flow_every": 8, "affine": False})
PHASE = Phase("moving", TOTAL, move=True)


@pytest.fixture(scope="module")
def views():
    """Alpha fills the picture, so that no step crops it; a corner does not count."""
    kept = np.full((SIZE, SIZE), 255, np.uint8)
    kept[: SIZE // 4, : SIZE // 4] = 0
    alpha = np.tile(np.linspace(128, 255, SIZE, dtype=np.uint8), (SIZE, 1))
    return replace(make_views(), load_alpha=lambda i: alpha, load_kept=lambda i: kept)


@pytest.mark.parametrize("scale", [1.0, 0.5])
def test_it_shows_one_frame_after_another(views, scale):
    one = OneView(views, scale)
    for i in (0, 3, 0):
        one.show(i, flow=True)
        for size in (scale, 0.5 * scale):
            got, want = one.rasterizer_camera(i, size), views.rasterizer_camera(i, size)
            assert torch.equal(got.K, want.K) and torch.equal(got.cam_from_world, want.cam_from_world)
            assert (got.width, got.height, got.near) == (want.width, want.height, want.near)
        assert torch.equal(one.target(i), views.target(i, scale)) and torch.equal(one.alpha(i), views.alpha(i, scale))
        assert torch.equal(one.kept(i), views.kept(i, scale)) and torch.equal(one.edges(i), views.edges(i, 0.5 * scale))
        assert float(one.moment(i)) == pytest.approx(views.moment(i), abs=1e-6)


@pytest.mark.parametrize("turning", [False, True], ids=["nodes", "and a rigid part"])
def test_a_step_of_it_is_that_of_the_views(views, turning):
    """Plain steps, and ones with priors, depths and flow."""
    model = fresh(views)
    model.field = make_nodes(model.gaussians.means.detach().numpy(), QUICK)
    if turning:
        g = torch.Generator().manual_seed(1)
        part = RigidParts.none().joined(torch.zeros(3), 0.5, torch.randn(4, 4, generator=g), 0.1 * torch.randn(4, 3, generator=g))
        model.field = model.field.with_rigid_parts(part)
    trainer = Trainer(model, views, [PHASE], QUICK, 90, recipe=NODES)
    trainer.objective.several = False
    one = OneView(views, 1.0)
    twin = model.twin()
    for step in (61, 62, 64, 68, 72):
        i = int(views.train[step % len(views.train)])
        want = trainer.objective(model, i, step, PHASE, 1)
        named = model.named_parameters()
        gradients = torch.autograd.grad(want.loss, list(named.values()), allow_unused=True)
        one.show(i, flow=True)
        with own_leaves(model.field):
            leaves = twin.named_parameters()
            assert leaves.keys() == named.keys() and not any(leaves[name] is p for name, p in named.items())
            got = trainer.objective.of(one)(twin, i, step, PHASE, 1)
            others = torch.autograd.grad(got.loss, list(leaves.values()), allow_unused=True)
        assert torch.allclose(got.loss, want.loss, rtol=1e-5) and torch.allclose(got.color, want.color, atol=1e-5)
        for name, a, b in zip(named, gradients, others, strict=True):
            assert (a is None) == (b is None), name
            assert a is None or (a - b).norm() <= 1e-3 * a.norm() + 1e-8, (step, name)
    assert all(p is named[name] for name, p in model.named_parameters().items())
    with torch.no_grad():
        model.gaussians.means.add_(1.0)
    assert torch.equal(twin.gaussians.means, model.gaussians.means)
