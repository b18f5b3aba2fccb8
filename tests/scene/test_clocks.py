"""Cameras of a rig whose clocks are off by parts of a frame: found from the motion, used, stored, and left alone where nothing tells."""

from types import SimpleNamespace

import numpy as np
import pytest
import torch
from e4dgs.scene.model import Model
from e4dgs.scene.motion.lifetimes.lifetime import set_lifetime
from e4dgs.scene.motion.lifetimes.lifetimes import Lifetimes
from e4dgs.scene.motion.times import corrected
from e4dgs.scene.training.control.clocks import AT, ClockControl
from e4dgs.scene.training.curriculum import Curriculum
from e4dgs.stages.shared.clocks import clock_lines
from sliding_gaussians import make_views, truth

TIMES, STEPS = 12, 100


def true_model(moves=True):
    """What `make_views` shows, as Gaussians that live always and drift."""
    gaussians = truth(0.5).gaussians
    motion = Lifetimes(TIMES)
    model = Model(gaussians, truth(0.5).convexes, motion, 0)
    set_lifetime(model.gaussians, 0.5 * (TIMES - 1), 100 * TIMES)
    model.gaussians.dynamic = torch.arange(12) < 6
    with torch.no_grad():
        model.gaussians.velocities.zero_()
        model.gaussians.velocities[:6, 0] = 0.6 / (TIMES - 1) if moves else 0.0
    return model


def looked(late, cameras=5, moves=True, active=True, times=TIMES):
    """(views, model, events) after all looks at the clocks of a rig whose cameras are ``late`` by so many frames."""
    views, events = make_views(cameras, times, 48, late), []
    model = true_model(moves)
    curriculum = Curriculum(views.train, views.time[views.train], 0, 0, 0)
    control = ClockControl(model, views, curriculum, STEPS, active, events.append)
    for step in range(STEPS):
        control.after_step(step, 1.0)
    return views, model, events


def frames(views):
    return {camera: late * (TIMES - 1) for camera, late in views.clocks.items()}


@pytest.mark.parametrize("late", [0.4, -0.4, 0.15])
def test_a_camera_that_is_off_is_found(late):
    views, model, events = looked({3: late})
    assert frames(views) == {3: pytest.approx(late, abs=0.02)}
    assert model.clocks == views.clocks and len(events) == len(AT)
    assert f"camera 3 {abs(late):.2f} frames {'late' if late > 0 else 'early'}" in events[-1]


def test_several_are_found_and_the_usual_clock_stays():
    views, _, _ = looked({1: 0.5, 2: -0.3})
    assert frames(views) == {1: pytest.approx(0.5, abs=0.02), 2: pytest.approx(-0.3, abs=0.02)}
    views, _, _ = looked(dict.fromkeys(range(5), 0.4))
    assert not views.clocks, "all of them together are the clock of the model"


@pytest.mark.parametrize(
    "case",
    [
        {"late": {}},
        {"late": {3: 0.03}},
        {"late": {3: 0.4}, "moves": False},
        {"late": {2: 0.4}, "cameras": 3},
        {"late": {3: 0.4}, "times": 6},
    ],
)
def test_what_is_right_small_or_not_told_is_left_alone(case):
    views, model, events = looked(**case)
    assert not views.clocks and not events and "clocks" not in model.config


def test_it_is_told_in_frames_and_by_the_name_of_a_picture():
    of_frames = SimpleNamespace(time=np.array([0, 0.1, 0.2] * 2), camera=np.repeat([0, 7], 3), names=[f"cam{k}" for k in range(6)])
    (line,) = clock_lines({7: -0.04}, of_frames)
    assert "camera of cam3 is off" in line and "0.40 frames earlier" in line and not clock_lines({}, of_frames)


def test_a_held_out_camera_and_moments_at_the_ends_stay_within_the_capture():
    assert corrected(0.5, 1, {2: 0.1}) == 0.5 and corrected(0.5, 2, {2: 0.1}) == pytest.approx(0.6)
    assert corrected(0.0, 2, {2: -0.1}) == 0.0 and corrected(1.0, 2, {2: 0.1}) == 1.0


def test_clocks_are_stored_with_the_model_and_in_checkpoints():
    views, model, _ = looked({3: 0.4})
    again = Model.from_arrays(model.to_arrays(), model.config)
    assert again.clocks == model.clocks and again.with_gaussians(again.gaussians).clocks == model.clocks
    curriculum = Curriculum(views.train, views.time[views.train], 0, 0, 0)
    fresh_views, fresh_model = make_views(5, TIMES, 48), true_model()
    state = ClockControl(model, views, curriculum, STEPS, True, print).state()
    control = ClockControl(fresh_model, fresh_views, curriculum, STEPS, True, print)
    control.load(state)
    assert fresh_views.clocks == fresh_model.clocks == views.clocks
    control.load({})
    assert fresh_views.clocks == {}, "checkpoints of earlier versions hold none"
