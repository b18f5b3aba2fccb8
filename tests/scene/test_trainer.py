"""The training loop on a scene of its own: a few coloured Gaussians that slide past fixed cameras."""

import dataclasses

import numpy as np
import pytest
import torch
from e4dgs.scene.primitives import ConvexSet
from e4dgs.scene.training.guard import MOST_IN_A_ROW, TrainingDiverged
from e4dgs.scene.training.recipe import NODES
from e4dgs.scene.training.schedule import Phase, coarse_phases, fine_phases, node_phases
from e4dgs.scene.training.trainer import GAUSSIANS_PER_PIXEL, Trainer
from e4dgs.stages.training.motions import make_nodes
from sliding_gaussians import SETTINGS, SIZE, fresh, make_views, wandering_views


@pytest.fixture(scope="module")
def views():
    return make_views()


def train(views, model=None, settings=SETTINGS, budget=90, phases=None, **options):
    model = model or fresh(views)
    trainer = Trainer(
        model, views, phases or coarse_phases("two-stage", settings.iterations, model.field is None), settings, budget, **options
    )
    return model, trainer.run(), trainer


def test_training_learns_the_scene_within_the_budget(views):
    settings = SETTINGS.model_copy(update={"iterations": 400})
    model, log, _ = train(views, settings=settings)
    assert log.iterations == 400 and log.nonfinite_steps == 0
    assert log.loss[-1][1] < 0.4 * log.loss[0][1]
    assert max(n for _, n, _ in log.primitives) <= 90
    assert any("do not move" in event for event in log.events)
    assert len(model.convexes) == 0


def test_static_scenes_have_no_field(views):
    model, log, _ = train(views, model=fresh(views, static=True))
    assert model.field is None and log.iterations == SETTINGS.iterations


@pytest.mark.parametrize("strategy", ["two-stage", "alternating"])
def test_convexes_join_and_are_refined(views, strategy):
    model, _, _ = train(views)
    centres = model.gaussians.means.detach().numpy()[:8]
    rng = np.random.default_rng(0)
    model.convexes = ConvexSet.from_hulls(centres[:, None] + 0.15 * rng.normal(size=(8, 6, 3)), np.full((8, 3), 0.4), 0)
    before = model.convexes.points.detach().clone()
    settings = SETTINGS.model_copy(update={"iterations": 260})
    _, log, _ = train(views, model, settings, phases=fine_phases(strategy, 0, 260, static=False), grow=False, lr_scale=0.3)
    assert 0 < len(model.convexes) <= 8
    if len(model.convexes) == 8:
        assert not torch.equal(model.convexes.points.detach(), before)
    assert np.isfinite(log.loss[-1][1])


def test_half_resolution_phase(views):
    _, log, _ = train(views, phases=[Phase("half", 60, move=False, scale=0.5)])
    assert log.iterations == 60


def test_measured_flow_is_used(views):
    asked = []

    def measured(i):
        asked.append(i)
        return (torch.zeros(16, 16, 2), torch.ones(16, 16)) if views.next[i] >= 0 else None

    train(views, measured_flow=measured)
    assert asked


def test_a_poisoned_image_stops_training_with_a_clear_message(views, monkeypatch):
    monkeypatch.setattr(views, "target", lambda i, scale=1.0, window=None: torch.full((SIZE, SIZE, 3), float("nan")))
    with pytest.raises(TrainingDiverged, match="frame"):
        train(views)


def test_one_bad_step_is_rolled_back_and_counted(views, monkeypatch):
    original, calls = views.target, []

    def target(i, scale=1.0, window=None):
        calls.append(i)
        return original(i, scale) * (float("inf") if len(calls) == 30 else 1.0)

    monkeypatch.setattr(views, "target", target)
    model, log, _ = train(views)
    assert 1 <= log.nonfinite_steps < MOST_IN_A_ROW
    assert all(torch.isfinite(p).all() for p in model.gaussians.parameters.values())


def test_a_training_that_no_longer_improves_stops(views):
    settings = SETTINGS.model_copy(update={"iterations": 5000, "lr_means": 1e-12, "densify_until": 0.0, "patience": 100})
    model, _, _ = train(views)
    _, log, _ = train(views, model, settings, grow=False, phases=[Phase("rest", 5000, move=False)])
    assert log.stopped.startswith("converged") and log.iterations < 5000


@pytest.mark.parametrize(("removed_at", "stops"), [(800, True), (801, False), (999, False)])
def test_a_removal_is_made_up_for_before_training_may_stop(views, removed_at, stops):
    """At step 1000, with a patience of 100, the loss of steps 800 to 1000 tells."""
    settings = SETTINGS.model_copy(update={"patience": 100, "densify_until": 0.0})
    trainer = Trainer(fresh(views, static=True), views, [Phase("rest", 1200, move=False)], settings, budget=90, recipe=NODES)
    trainer.log.loss = [[step, 0.1] for step in range(0, 1001, 20)]
    trainer.iteration = removed_at
    keep = torch.arange(len(trainer.model.gaussians) - 5)
    trainer._replace(trainer.model.gaussians.select(keep), keep)
    trainer.iteration = 1000
    assert trainer._converged() is stops


def test_control_nodes_are_spread_anew_and_learn():
    views = wandering_views()
    settings = SETTINGS.model_copy(update={"iterations": 240})
    model = fresh(views, static=True)
    model.gaussians.dynamic[:] = True
    model.field = make_nodes(model.gaussians.means.detach().numpy(), settings)
    _, log, _ = train(views, model, settings, phases=node_phases(240, 0.5), recipe=NODES)
    assert sum("spread anew" in event for event in log.events) == len(NODES.spread_at)
    assert log.loss[-1][1] < 0.7 * log.loss[0][1]


def test_the_captures_alpha_forbids_to_hide_dark_surfaces_as_holes():
    """Black things before a black background: without alpha nothing asks for them."""
    source = make_views(cameras=3, times=2)
    dark = dataclasses.replace(
        source, load=lambda i: np.zeros((SIZE, SIZE, 3), np.uint8), load_alpha=lambda i: disc, background=(0.0, 0.0, 0.0), stored_edges=None
    )
    rows, columns = np.mgrid[:SIZE, :SIZE]
    disc = (((rows - SIZE / 2) ** 2 + (columns - SIZE / 2) ** 2 < (SIZE / 4) ** 2) * 255).astype(np.uint8)
    found = {}
    for alpha in (0.0, 0.5):
        settings = SETTINGS.model_copy(update={"iterations": 150, "alpha": alpha})
        model, _, _ = train(dark, fresh(dark, static=True), settings, phases=[Phase("still", 150, move=False)])
        shown = model.render(dark.rasterizer_camera(0), 0.0).alpha[SIZE // 2, SIZE // 2]
        found[alpha] = float(shown)
    assert found[0.5] > 0.8 > found[0.0]


def test_small_images_hold_few_gaussians(views):
    _, log, _ = train(views, budget=500, phases=[Phase("quarter", 400, move=False, scale=0.25)], recipe=NODES)
    assert max(n for _, n, _ in log.primitives) <= max(60, round(GAUSSIANS_PER_PIXEL * (SIZE // 4) ** 2))


@pytest.mark.parametrize(("prune_at", "step"), [(NODES.prune_at, 34), (1.0, 40)])
def test_what_is_hardly_seen_goes_once_and_steps_follow(views, prune_at, step):
    model = fresh(views, static=True)
    model.gaussians.dynamic[:] = True
    model.field = make_nodes(model.gaussians.means.detach().numpy(), SETTINGS)
    _, log, _ = train(views, model, phases=node_phases(40, 1.0), recipe=dataclasses.replace(NODES, prune_at=prune_at))
    removals = [event for event in log.events if "hardly blended" in event]
    assert len(removals) == 1 and removals[0].startswith(f"step {step}: ")
