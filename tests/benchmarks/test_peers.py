"""The contenders in torch compute what they are compared with."""

import pytest
import torch
from bench_rows.peers.field import TorchField
from bench_rows.peers.loss import torch_loss
from bench_rows.peers.rasterizer import rasterize_torch
from e4dgs.rasterizer import rasterize
from e4dgs.rasterizer.reference.blend import MAX_ALPHA, MIN_ALPHA, MIN_TRANSMITTANCE
from e4dgs.rasterizer.reference.compare import relative_l2
from e4dgs.workflows.bench import scenes
from e4dgs.workflows.bench.rows import Bench
from rasterizer.thresholds import decided_by_threshold, raw_alphas


def small_scene(degree):
    scene = scenes.cloud(150, 48, 36, degree, size=0.2)
    scene.background = torch.tensor([0.2, 0.5, 0.8])
    return scene


@pytest.mark.parametrize("degree", [None, 2])
def test_the_torch_rasterizer_equals_the_reference(degree):
    """Also where a tile's list is longer than one block, and where pixels stop."""
    scene = small_scene(degree)
    raw, _ = raw_alphas(scene)
    left = torch.cumprod(1 - torch.where(raw >= MIN_ALPHA, raw.clamp(max=MAX_ALPHA), 0.0), 1)
    assert float(left.min()) < MIN_TRANSMITTANCE, "some pixels stop"
    decided = decided_by_threshold(scene)
    assert float(decided.double().mean()) < 0.25
    weights = torch.randn(36, 48, 3, generator=torch.Generator().manual_seed(0)) * ~decided[..., None]
    found = {}
    for name, render in (("torch", rasterize_torch), ("reference", rasterize)):
        leaves = scene.primitive_leaves()
        attached = scene.having(leaves)
        options = {"backend": "reference"} if name == "reference" else {"block": 16, "together": 5}
        frame = render(attached.camera, attached.gaussians, None, attached.background, **options)
        (frame.color * weights.to(frame.color.dtype)).sum().backward()
        found[name] = frame, {field: leaf.grad for field, leaf in leaves.items()}
    (ours, gradients), (want, exact) = found["torch"], found["reference"]
    for name in ("color", "alpha", "depth"):
        assert float((getattr(ours, name) - getattr(want, name))[~decided].abs().max()) < 1e-4, name
    for name, value in exact.items():
        assert relative_l2(gradients[name], value) < 1e-3, name


@pytest.mark.parametrize("lookup", ["grid_sample", "gather"])
def test_the_composed_field_equals_the_field(lookup):
    from bench_rows.field.field_torch import errors_of, outcome, outer_gradients, trained_field

    field, rest = trained_field(16), torch.rand(200, 3, generator=torch.Generator().manual_seed(1)) * 2.4 - 1.2
    weights = outer_gradients(field, rest)
    exact = TorchField(field.state_dict(), torch.float64, lookup)
    assert max(errors_of(outcome(field, rest, weights), outcome(exact, rest, weights)).values()) < 1e-4
    assert float(field.regulariser()) == pytest.approx(float(exact.regulariser()), rel=1e-5)
    for ours, theirs in zip(field.priors(rest, rest + 0.01, 0.0, 0.1), exact.priors(rest.double(), rest.double() + 0.01, 0.0, 0.1)):
        assert float(ours) == pytest.approx(float(theirs), rel=1e-3)


def test_the_torch_loss_equals_the_oracle():
    from bench_rows.field.loss_torch import images, oracle, outcome

    target, image = (x.double() for x in images(40, 30))
    for got, want in zip(outcome(torch_loss, image, target), outcome(oracle, image, target)):
        assert relative_l2(got, want) < 1e-12


def test_the_composed_step_computes_what_ours_computes():
    """Two trainers from one model take a period of steps; their Gaussians end in the same place, as far as float32 allows."""
    from bench_rows.peers.step import composed_of_torch, copy_of, torch_kernels, with_torch_adam
    from e4dgs.workflows.bench.step.training import make_model, make_trainer, views_of

    bench = Bench(scale=0.01)
    views, masks, _ = views_of(bench)
    model = make_model(bench, views, masks)
    start = model.gaussians.sh_dc.detach().clone()
    peer = composed_of_torch(copy_of(model))
    ours, period = make_trainer(model, views)
    theirs, torch_period = make_trainer(peer, views)
    with_torch_adam(theirs)
    period()
    with torch_kernels():
        torch_period()
    assert ours.loss.value() == pytest.approx(theirs.loss.value(), rel=1e-2)
    moved, moved_too = model.gaussians.sh_dc.detach() - start, peer.gaussians.sh_dc.detach() - start
    assert relative_l2(moved_too, moved) < 0.1
