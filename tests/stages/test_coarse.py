"""The stages `seeds` and `coarse` on a ball that crosses a room before a moving camera: it begins with seeds on the ball, or without."""

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from e4dgs.scene.motion import interface
from e4dgs.scene.motion import phases as schedule
from e4dgs.stages.coarse.settings import CoarseSettings
from e4dgs.stages.coarse.stage import Coarse
from e4dgs.stages.seeds.artifact import StoredSeeds
from e4dgs.stages.seeds.settings import SeedsSettings
from e4dgs.stages.seeds.stage import Seeds
from e4dgs.stages.shared.dataset import load_frameset, load_views
from e4dgs.stages.shared.model import read_model
from factory import Cells, Motion, Object, Options, Sphere, make, optical_flow, render, write_colmap
from run_stage import run_frames, run_stage
from write_artifact import write_artifact

WIDTH, HEIGHT, FRAMES = 96, 72, 9
ITERATIONS = 36
KIND = {"with_masks": "lifetimes", "without_masks": "planes"}


@pytest.fixture(scope="module")
def ball(tmp_path_factory) -> SimpleNamespace:
    """The capture; frames and flow as artifacts, flow and masks of the ball being exact; `shown` [F, H, W] bool: where the ball is."""
    options = Options(
        backdrop="room", rig="path", boxes=0, spheres=0, times=FRAMES, width=WIDTH, height=HEIGHT, samples=2, fov_degrees=60.0
    )
    made = make(options)
    thing = Object("ball", Sphere(0.45), Cells(0.4, 1), Motion((0.0, 0.0, 0.45), slide=(2.0, 0.0, 0.0)))
    scene, views = replace(made.scene, objects=(*made.scene.objects, thing)), made.views
    folder = tmp_path_factory.mktemp("ball")
    frames = run_frames(write_colmap(replace(made, scene=scene), folder / "capture").root, folder, holdout=0)
    pairs = [(views[k], views[k + 1]) for k in range(FRAMES - 1)]
    forth = [optical_flow(scene, a.camera, a.time, b.time, b.camera) for a, b in pairs]
    back = [optical_flow(scene, b.camera, b.time, a.time, a.camera) for a, b in pairs]
    shown = np.stack([render(scene, view.camera, view.time, samples=1).object > 0 for view in views])
    flow = {
        "pair": np.array([(k, k + 1) for k in range(FRAMES - 1)], np.int32),
        "forward": np.stack([found.flow for found in forth]).astype(np.float16),
        "backward": np.stack([found.flow for found in back]).astype(np.float16),
        "confidence": np.stack([255 * found.visible for found in forth]).astype(np.uint8),
    }
    masks = {"moving": 255 * shown.astype(np.uint8)}
    inputs = {"frames": frames.artifact, "poses": None}
    return SimpleNamespace(
        capture=frames.context.capture,
        scene=scene,
        views=views,
        shown=shown,
        with_masks={**inputs, "flow": write_artifact(folder / "masks", flow | masks)},
        without_masks={**inputs, "flow": write_artifact(folder / "no masks", flow)},
    )


def train(ball, inputs, folder):
    """What ran, with the lines of both stages, and the phases of the training."""
    phases: list[schedule.Phase] = []
    planned = schedule.coarse_phases

    def plan(*given):
        phases.extend(planned(*given))
        return phases

    seeds = run_stage(Seeds(), ball.capture, folder, SeedsSettings(), inputs)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(interface, "coarse_phases", plan)
        ran = run_stage(Coarse(), ball.capture, folder, CoarseSettings(iterations=ITERATIONS), inputs | {"seeds": seeds.artifact})
    return replace(ran, lines=seeds.lines + ran.lines), phases


@pytest.fixture(scope="module")
def with_masks(ball, tmp_path_factory):
    return train(ball, ball.with_masks, tmp_path_factory.mktemp("masks"))


@pytest.fixture(scope="module")
def without_masks(ball, tmp_path_factory):
    return train(ball, ball.without_masks, tmp_path_factory.mktemp("no masks"))


@pytest.mark.parametrize("which", ["with_masks", "without_masks"])
def test_training_stays_finite_and_learns(ball, which, request):
    ran = request.getfixturevalue(which)[0]
    artifact = ran.artifact
    assert all(np.isfinite(artifact.read(name)).all() for name in artifact.names())
    assert artifact.attrs["model"]["field"]["kind"] == KIND[which] and artifact.attrs["iterations"] == ITERATIONS
    training = artifact.info["training"]
    assert training["iterations"] == ITERATIONS and training["nonfinite_steps"] == 0
    model, views = read_model(artifact), load_views(load_frameset(ran.context.inputs, ball.capture.root), None)
    nothing = torch.tensor(model.background)  # what the best single colour leaves
    errors = []
    for i in map(int, views.train):
        errors.append([float((shown - views.target(i)).square().mean()) for shown in (rendered(model, views, i), nothing)])
    left, without = np.mean(errors, 0)
    assert left < 0.8 * without, f"{left} against {without}"


def test_with_masks_what_moves_has_seeds_and_a_life_and_motion_needs_no_warm_up(with_masks):
    ran, phases = with_masks
    (told,) = [line for line in ran.lines if "on moving objects, at" in line]
    seeds, times = map(int, re.fullmatch(r"seeds: (\d+) on moving objects, at (\d+) times", told).groups())
    assert seeds > 300 and times == len(ran.context.inputs["frames"].read("split")) - int(
        ran.context.inputs["frames"].read("split").astype(bool).sum()
    )
    assert len(ran.artifact.read("gaussians_means")) > 300, "more than the points of the capture"
    assert len(np.unique(ran.artifact.read("gaussians_times"))) > times
    assert phases and all(phase.move for phase in phases)


def test_without_masks_training_begins_at_rest(without_masks):
    ran, phases = without_masks
    assert not any("seeds on moving objects" in line for line in ran.lines)
    assert not phases[0].move and phases[-1].move


def test_before_one_camera_the_room_has_dense_seeds_and_measured_depth_though_the_capture_has_points(ball, with_masks):
    """The capture brings 200 points, as structure from motion does. A sweep along the path finds the depth of the room behind the ball."""
    ran, _ = with_masks
    assert any(line.startswith("seeds: 2") and "points of the capture" in line for line in ran.lines)
    assert (~ran.artifact.read("gaussians_dynamic")).sum() > 2000
    depth, views = (
        StoredSeeds.read(ran.context.inputs["seeds"]).depth,
        load_views(load_frameset(ran.context.inputs, ball.capture.root), None),
    )
    assert set(depth) <= set(views.train.tolist()) and len(depth) > 0.6 * len(views.train)
    for i, inverse in depth.items():
        truth = render(ball.scene, ball.views[i].camera, ball.views[i].time, samples=1)
        known = (inverse > 0) & (truth.object == 0)
        assert known.mean() > 0.2 and np.median(np.abs(inverse[known] * truth.depth[known] - 1)) < 0.03
        assert (inverse[truth.object > 0] > 0).mean() < 0.1, "none on what moves"


def test_on_a_narrow_path_colours_have_degree_1(with_masks):
    ran, _ = with_masks
    (told,) = [line for line in ran.lines if line.startswith("SH degree")]
    assert told.startswith("SH degree 1: ") and ran.artifact.attrs["model"]["sh_degree"] == 1


def rendered(model, views, i):
    return model.render(views.rasterizer_camera(i), float(views.time[i])).color


def test_at_each_time_what_is_there_lies_on_the_ball(ball, with_masks):
    """It crosses more than half of the picture. What lives then and where covers it, in frames without seeds too."""
    ran, _ = with_masks
    model, views = read_model(ran.artifact), load_views(load_frameset(ran.context.inputs, ball.capture.root), None)
    moving = model.gaussians.dynamic.nonzero()[:, 0]
    lives = model.gaussians.log_spans[moving] < np.log(2 * FRAMES)
    for i, t in enumerate(views.time):
        with torch.no_grad():
            there = model.at(float(t))[0]
        places, opacity = there.means[moving][lives].double().numpy(), there.opacities[moving][lives].numpy()
        found = views.project(i, places)
        on = ball.shown[i, found.y, found.x]
        assert (opacity[found.point] * on).sum() > 0.4 * opacity.sum()
