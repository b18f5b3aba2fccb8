"""The training loop on a scene of its own: a few coloured Gaussians that slide past fixed cameras."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from e4dgs.scene.losses.appearance import on_other_background
from e4dgs.scene.losses.surface import SMOOTH_END, Surface
from e4dgs.scene.losses.term import Measured
from e4dgs.scene.motion.lifetimes.lifetime import set_lifetime
from e4dgs.scene.motion.lifetimes.lifetimes import Lifetimes
from e4dgs.scene.motion.nodes.control_nodes import ControlNodes
from e4dgs.scene.motion.nodes.schedule import NODES, node_phases
from e4dgs.scene.motion.phases import Phase, coarse_phases, fine_phases
from e4dgs.scene.motion.planes.field import DeformationField
from e4dgs.scene.primitives import ConvexSet
from e4dgs.scene.training import convergence, objective
from e4dgs.scene.training.control.growth import GAUSSIANS_PER_PIXEL
from e4dgs.scene.training.curriculum import MIN_CAMERAS
from e4dgs.scene.training.drawn_tiles import LEAST_TIMES, Drawn
from e4dgs.scene.training.guard import MOST_IN_A_ROW, TrainingDiverged
from e4dgs.scene.training.trainer import Trainer
from sliding_gaussians import SETTINGS, SIZE, fresh, make_views, wandering_views


@pytest.fixture(scope="module")
def views():
    return make_views()


def train(views, model=None, settings=SETTINGS, budget=90, phases=None, **options):
    model = model or fresh(views)
    trainer = Trainer(
        model, views, phases or coarse_phases("two-stage", settings.iterations, model.motion is None), settings, budget, **options
    )
    return model, trainer.run(), trainer


def psnr(model, views):
    """Over all views, at full size."""
    errors = []
    with torch.no_grad():
        for i in views.train:
            color = model.render(views.rasterizer_camera(int(i)), float(views.time[i])).color
            errors.append(float((color - views.target(int(i))).square().mean()))
    return -10 * float(np.log10(np.mean(errors)))


def test_training_learns_the_scene_within_the_budget(views):
    settings = SETTINGS.model_copy(update={"iterations": 400})
    model, log, _ = train(views, settings=settings)
    assert log.iterations == 400 and log.nonfinite_steps == 0
    assert log.loss[-1][1] < 0.4 * log.loss[0][1]
    assert max(n for _, n, _ in log.primitives) <= 90
    assert any("do not move" in event for event in log.events)
    assert len(model.convexes) == 0


def test_a_scene_without_motion_is_learned_and_is_the_same_at_all_times(views):
    model = fresh(views, static=True)
    before = psnr(model, views)
    train(views, model=model)
    assert psnr(model, views) > before + 3
    first, last = (model.render(views.rasterizer_camera(0), t).color for t in (0.0, 1.0))
    assert torch.equal(first, last)


@pytest.mark.parametrize("strategy", ["two-stage", "alternating"])
def test_convexes_join_and_are_refined(views, strategy):
    model, _, _ = train(views)
    centres = model.gaussians.means.detach().numpy()[:8]
    rng = np.random.default_rng(0)
    model.convexes = ConvexSet.from_points(centres[:, None] + 0.15 * rng.normal(size=(8, 6, 3)), np.full((8, 3), 0.4), 0)
    before, points = psnr(model, views), model.convexes.points.detach().clone()
    settings = SETTINGS.model_copy(update={"iterations": 260})
    train(views, model, settings, phases=fine_phases(strategy, 0, 260, static=False), grow=False, lr_scale=0.3)
    assert psnr(model, views) > before + 1
    after = model.convexes.points.detach()
    assert len(after) and float(torch.cdist(after.flatten(1), points.flatten(1)).min()) > 1e-3, "each has learned"


def test_images_of_half_the_size_teach_what_the_whole_ones_show(views):
    model = fresh(views, static=True)
    before = psnr(model, views)
    train(views, model, phases=[Phase("half", 60, move=False, scale=0.5)])
    assert psnr(model, views) > before + 2


def test_measured_flow_steers_the_motion(views):
    """Half of the scene slides. A flow that says otherwise, and weighs much, holds it."""

    def still(i):
        return (torch.zeros(SIZE // 2, SIZE // 2, 2), torch.ones(SIZE // 2, SIZE // 2)) if views.next[i] >= 0 else None

    settings = SETTINGS.model_copy(update={"iterations": 240, "data_flow_weight": 0.3, "flow_every": 1, "interval_weight": 0.0})
    paths = []
    for measured in (None, still):
        model, _, _ = train(views, settings=settings, measured=Measured(measured))
        moving = model.gaussians.dynamic.nonzero()[:, 0]
        first, last = (model.carried(moving, t).points.detach() for t in (0.0, 1.0))
        paths.append(float((last - first).norm(dim=1).sum()))
    assert paths[1] < 0.5 * paths[0]


def test_a_poisoned_image_stops_training_with_a_clear_message(views, monkeypatch):
    monkeypatch.setattr(views, "stored", lambda i, scale, kind, window=None: torch.full((SIZE, SIZE, 3), float("nan")))
    with pytest.raises(TrainingDiverged, match="frame"):
        train(views)


def test_one_bad_step_is_rolled_back_and_counted(views, monkeypatch):
    original, calls = views.stored, []

    def stored(i, scale, kind, window=None):
        calls.append(i)
        return original(i, scale, kind, window) * (float("inf") if len(calls) == 30 else 1.0)

    monkeypatch.setattr(views, "stored", stored)
    model, log, _ = train(views)
    assert 1 <= log.nonfinite_steps < MOST_IN_A_ROW
    assert all(torch.isfinite(p).all() for p in model.gaussians.parameters.values())
    assert log.loss[-1][1] < log.loss[0][1], "and does not spoil the losses after it"


def test_a_training_that_no_longer_improves_stops(views):
    settings = SETTINGS.model_copy(update={"iterations": 5000, "lr_means": 1e-12, "densify_until": 0.0, "patience": 100})
    model, _, _ = train(views)
    _, log, _ = train(views, model, settings, grow=False, phases=[Phase("rest", 5000, move=False)])
    assert log.stopped.startswith("converged") and log.iterations < 5000


@pytest.mark.parametrize(("removed_at", "stopped_at"), [(200, 400), (201, 500), (299, 500), (301, 600)])
def test_a_removal_is_made_up_for_before_training_may_stop(views, monkeypatch, removed_at, stopped_at):
    """With a patience of 100, the losses of the last 200 steps tell; they are looked at every 100 steps, from half of the steps on."""
    monkeypatch.setattr(convergence, "CONVERGED", 0.99)  # no improvement is enough
    settings = SETTINGS.model_copy(update={"patience": 100, "densify_until": 0.0, "min_contribution": 5.0})
    recipe = dataclasses.replace(DeformationField.recipe, prune_at=removed_at / 800)
    model = fresh(views, static=True)
    before = len(model.gaussians)
    _, log, _ = train(views, model, settings, phases=[Phase("rest", 800, move=False)], recipe=recipe)
    assert f"step {removed_at}: removed" in log.events[0] and 0 < len(model.gaussians) < before
    assert log.iterations == stopped_at


def test_control_nodes_are_spread_anew_and_learn():
    views = wandering_views()
    settings = SETTINGS.model_copy(update={"iterations": 240})
    model = fresh(views, static=True)
    model.gaussians.dynamic[:] = True
    model.motion = ControlNodes.over(model.gaussians.means.detach().numpy(), settings.seed)
    begun, before = model.motion.positions.clone(), psnr(model, views)
    train(views, model, settings, phases=node_phases(240, 0.5), recipe=NODES)
    moved = torch.cdist(model.motion.positions, begun).amin(1)
    assert float(moved.median()) > 0.01
    assert psnr(model, views) > before + 3


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
        settings = SETTINGS.model_copy(update={"iterations": 150, "alpha_weight": alpha})
        model, _, _ = train(dark, fresh(dark, static=True), settings, phases=[Phase("still", 150, move=False)])
        shown = model.render(dark.rasterizer_camera(0), 0.0).alpha[SIZE // 2, SIZE // 2]
        found[alpha] = float(shown)
    assert found[0.5] > 0.8 > found[0.0]


def test_what_is_compared_on_the_other_background_is_what_a_render_on_it_shows(views):
    model, camera = fresh(views), views.rasterizer_camera(0)
    black, white = torch.zeros(3), torch.ones(3)
    on_black, on_white = (model.render(camera, 0.0, background) for background in (black, white))
    alpha = torch.linspace(0, 1, SIZE)[:, None].expand(SIZE, SIZE)
    red = torch.tensor([1.0, 0.0, 0.0])
    color, target = on_other_background(on_black, alpha[..., None] * red, alpha, black, None)
    assert torch.allclose(color, on_white.color, atol=1e-6)
    assert torch.allclose(target, alpha[..., None] * red + (1 - alpha)[..., None], atol=1e-6)
    back, _ = on_other_background(on_white, target, alpha, white, None)
    assert torch.allclose(back, on_black.color, atol=1e-6)
    kept = torch.arange(SIZE)[None].expand(SIZE, SIZE) < SIZE // 2
    color, target = on_other_background(on_black, alpha[..., None] * red, alpha, black, kept)
    assert torch.equal(color[~kept], target[~kept]) and not torch.equal(color[kept], target[kept])


def test_small_images_hold_few_gaussians(views):
    most = {}
    for scale in (0.25, 1.0):
        _, log, _ = train(views, fresh(views, static=True), budget=500, phases=[Phase("a", 400, move=False, scale=scale)], recipe=NODES)
        most[scale] = max(n for _, n, _ in log.primitives)
    few = max(60, round(GAUSSIANS_PER_PIXEL * (SIZE // 4) ** 2))
    assert most[0.25] <= few < most[1.0]


@pytest.mark.parametrize(("prune_at", "step"), [(NODES.prune_at, 34), (1.0, 40)])
def test_what_is_hardly_seen_goes_once_and_steps_follow(views, prune_at, step):
    model = fresh(views, static=True)
    model.gaussians.dynamic[:] = True
    model.motion = ControlNodes.over(model.gaussians.means.detach().numpy(), SETTINGS.seed)
    with torch.no_grad():
        model.gaussians.means[:7] = torch.tensor([0.0, 0.0, -50.0])  # behind all cameras
    _, log, _ = train(views, model, phases=node_phases(40, 1.0), recipe=dataclasses.replace(NODES, prune_at=prune_at))
    assert float(model.gaussians.means.detach()[:, 2].min()) > -10
    removals = [event for event in log.events if "hardly any training view shows them" in event]
    assert len(removals) == 1 and removals[0].startswith(f"step {step}: ")


def test_a_long_training_that_draws_only_some_of_the_static_tiles_learns_the_whole_scene():
    views = make_views(cameras=1, times=LEAST_TIMES, size=64)
    still = np.median([views.load(int(i)) for i in views.train], axis=0)
    views.load_moving = lambda i: (np.abs(views.load(i) - still).max(-1) > 30).astype(np.uint8) * 255
    model = fresh(views)
    before = psnr(model, views)
    _, log, trainer = train(views, model=model, earlier=100_000)
    drawn = [trainer.objective.drawn.of(int(i), 1.0, step) for step, i in enumerate(views.train)]
    assert min(float(one.tiles.float().mean()) for one in drawn) < 1
    assert psnr(model, views) > before + 3
    assert log.nonfinite_steps == 0 and log.psnr[-1][1] > log.psnr[0][1] + 1


def test_a_training_that_leaves_out_what_is_not_in_view_learns_the_same(monkeypatch):
    """What no ray sees is left alone anyway, but for the penalty on opacity."""
    views = make_views(cameras=2, times=LEAST_TIMES, size=64)
    settings = SETTINGS.model_copy(update={"iterations": 60, "opacity_weight": 0.1})
    ends, counts = [], []
    for most in (0.0, 1.0):  # 0: all Gaussians in every step
        monkeypatch.setattr(objective, "MOST_SHOWN", most)
        model = fresh(views)
        with torch.no_grad():
            model.gaussians.means[::2] += 3.0  # out of view
            model.gaussians.log_scales += torch.tensor([0.3, 0.0, -0.3])  # of a sphere, the turn would be trained by rounding alone
        model.motion = Lifetimes(LEAST_TIMES)
        set_lifetime(model.gaussians, torch.arange(len(model.gaussians)) % LEAST_TIMES, 1.5)
        _, _, trainer = train(views, model=model, settings=settings, recipe=Lifetimes.recipe)
        found = trainer.objective(model, 0, 0, Phase("deformation", 1), 0)
        counts.append(None if found.rows.index is None else len(found.rows.index))
        ends.append(trainer.learned.tensors())
    assert counts[0] is None and 0 < counts[1] < len(model.gaussians)
    assert ends[0].keys() == ends[1].keys() and all(torch.allclose(ends[0][name], ends[1][name], rtol=1e-4, atol=3e-5) for name in ends[0])


@pytest.mark.parametrize(("cameras", "weight"), [(MIN_CAMERAS - 1, 0.0), (MIN_CAMERAS, 1.0)])
def test_surfaces_that_several_cameras_see_are_smoothed_less_and_less(cameras, weight):
    views = make_views(cameras=cameras, times=2, size=8)
    for earlier in (0, 300):
        _, _, trainer = train(views, settings=SETTINGS.model_copy(update={"iterations": 100}), earlier=earlier)
        begin, end = (Surface(trainer.objective.run).smooth(step) for step in (0, 100))
        assert begin == pytest.approx(weight * SETTINGS.smooth_weight * SMOOTH_END ** (earlier / (earlier + 100)))
        assert end == pytest.approx(weight * SETTINGS.smooth_weight * SMOOTH_END)


def test_a_step_that_draws_nothing_changes_no_shape_and_has_a_finite_psnr(monkeypatch):
    views = make_views(cameras=1, times=LEAST_TIMES, size=64)
    views.load_moving = lambda i: np.zeros((64, 64), np.uint8)
    model, _, trainer = train(views, settings=SETTINGS.model_copy(update={"iterations": 1}))
    nothing = Drawn(torch.zeros(4, 4))
    monkeypatch.setattr(trainer.objective, "drawn", SimpleNamespace(of=lambda *given: nothing))
    found = trainer.objective(model, 0, 0, Phase("deformation", 1), 0)
    found.loss.backward()
    assert np.isfinite(found.psnr()) and float(found.image_loss) == pytest.approx(0, abs=1e-6)
    shapes = model.gaussians.parameters
    assert all(shapes[name].grad is None or not shapes[name].grad.any() for name in ("log_scales", "quats", "sh_dc"))
