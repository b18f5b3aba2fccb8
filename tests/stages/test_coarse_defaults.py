"""What `coarse` chooses by itself."""

from types import SimpleNamespace

import numpy as np
import pytest
from e4dgs.scene.motion.kinds import KINDS, choose
from e4dgs.scene.motion.start import Start
from e4dgs.stages.coarse.defaults import LEAST_ITERATIONS, auto_iterations
from e4dgs.stages.coarse.run import first_model
from e4dgs.stages.coarse.settings import CoarseSettings
from e4dgs.stages.facts import Facts
from e4dgs.stages.shared.defaults import CLIP_PIXELS, auto_budget, found_facts


@pytest.mark.parametrize(
    ("frames", "times", "cameras", "static", "expected"),
    [
        (81, 67, 81, False, KINDS["nodes"].steps),  # a new camera at every time
        (90, 90, 1, False, 6000),  # one camera over time
        (372, 12, 31, False, 6000),  # a rig over few times
        (4 * 45, 45, 4, False, 12_600),
        (4 * 45 - 1, 45, 4, False, 6000),
        (8 * 45, 45, 8, True, 6000),
        (20 * 300, 300, 20, False, 30_000),
    ],
)
def test_steps_follow_the_times_that_a_rig_must_learn_one_after_another(frames, times, cameras, static, expected):
    facts = Facts(frames=frames, times=times, cameras=cameras, static=static)
    assert auto_iterations(facts, CoarseSettings()) == expected
    assert auto_iterations(facts, CoarseSettings(effort=0.5)) == round(0.5 * expected)
    assert auto_iterations(facts, CoarseSettings(effort=0.01)) == LEAST_ITERATIONS


@pytest.mark.parametrize(
    ("views", "effort", "expected"),
    [
        *((10, 1, 20_000), (50, 1, 20_000), (51, 1, 20_400), (79, 1, 31_600), (100, 1, 32_000)),  # as many as views can use
        *((50, 0.2, 6400), (50, 0.5, 16_000), (50, 0.7, 20_000), (50, 3, 60_000), (100, 3, 96_000), (50, 0.01, LEAST_ITERATIONS)),
    ],
)
def test_steps_of_nodes_follow_the_views_that_they_learn_from(views, effort, expected):
    facts = Facts(frames=views + 20, times=views, cameras=views + 20, splits={"train": views, "test": 20})
    assert choose(None, facts) == "nodes"
    assert auto_iterations(facts, CoarseSettings(effort=effort)) == expected


def test_large_clips_get_fewer_steps_on_a_cpu():
    clip = {"frames": 120, "times": 120, "cameras": 1, "pairs": 104}
    steps = [
        auto_iterations(Facts(**clip, width=w, height=h), CoarseSettings()) for w, h in ((480, 270), (400, 500), (960, 540), (3840, 2160))
    ]
    assert steps == [6000, 6000, round(6000 * CLIP_PIXELS / (960 * 540)), LEAST_ITERATIONS]
    assert auto_iterations(Facts(**clip, width=960, height=540), CoarseSettings(), "cuda") == 6000
    for other in ({"static": True}, {"cameras": 8, "frames": 8 * 20, "times": 20}, {"pairs": 0, "cameras": 3}):
        assert auto_iterations(Facts(**{**clip, **other}, width=960, height=540), CoarseSettings()) == 6000


CLIP = {"frames": 90, "cameras": 1, "times": 90, "pairs": 89}
ORBIT = {"frames": 81, "cameras": 81, "times": 67, "pairs": 0}
RIG = {"frames": 360, "cameras": 8, "times": 45, "pairs": 352}


@pytest.mark.parametrize(
    ("facts", "asked", "moving_seeds", "kind"),
    [
        (ORBIT, None, None, "nodes"),  # each frame is from another side
        (ORBIT, "planes", None, "planes"),
        (ORBIT | {"times": 8}, None, None, "planes"),  # too few to tell a path
        (ORBIT | {"static": True}, None, None, "static"),
        (ORBIT | {"static": True}, "nodes", None, "static"),
        (CLIP, None, None, "lifetimes"),
        (CLIP, None, True, "lifetimes"),
        (CLIP, None, False, "planes"),  # no seed was found on what moves
        (CLIP, "nodes", None, "nodes"),
        (CLIP, "planes", True, "planes"),
        (CLIP, "lifetimes", False, "lifetimes"),
        (RIG, None, None, "lifetimes"),
        (RIG | {"fixed_cameras": True}, None, None, "lifetimes"),
        (CLIP | {"fixed_cameras": True}, None, None, "lifetimes"),  # one camera that stands still
        (CLIP | {"fixed_cameras": True}, None, False, "planes"),
    ],
)
def test_what_moves_a_capture_follows_from_how_it_was_filmed(facts, asked, moving_seeds, kind):
    assert choose(asked, Facts.of(facts), moving_seeds) == kind


@pytest.mark.parametrize(
    ("said", "found", "static"), [(True, None, True), (False, None, False), (False, False, False), (False, True, True)]
)
def test_a_scene_is_static_where_the_user_says_so_or_flow_has_found_it(said, found, static):
    flow = None if found is None else SimpleNamespace(attrs={"static": found})
    views = SimpleNamespace(time=np.zeros(3))
    assert found_facts(SimpleNamespace(facts={"static": said}, inputs={"flow": flow}), views).static is static
    old = SimpleNamespace(attrs={"method": "dis-medium"})
    assert found_facts(SimpleNamespace(facts={"static": said}, inputs={"flow": old}), views).static is said


@pytest.mark.parametrize(("cameras", "fixed", "stands"), [(1, True, True), (1, None, False), (3, True, False)])
def test_one_camera_stands_still_where_poses_have_found_it(cameras, fixed, stands):
    poses = None if fixed is None else SimpleNamespace(attrs={"fixed_cameras": fixed})
    ctx = SimpleNamespace(facts={"cameras": cameras}, inputs={"flow": None, "poses": poses})
    assert found_facts(ctx, SimpleNamespace(time=np.zeros(3))).stands_still is stands


@pytest.mark.parametrize(("found", "times"), [(True, 1), (True, 20), (False, 1)])
def test_a_static_scene_has_as_many_times_as_training_sees(found, times):
    ctx = SimpleNamespace(facts={"frames": 20, "times": 20}, inputs={"flow": SimpleNamespace(attrs={"static": found})})
    facts = found_facts(ctx, SimpleNamespace(time=np.arange(20) % times))
    assert (facts.times, facts.rig) == ((times, times == 1) if found else (20, False))


@pytest.mark.parametrize("kind", ["nodes", "planes", "lifetimes", "static"])
def test_models_are_antialiased_unless_they_are_asked_not_to_be(kind):
    points = np.random.default_rng(0).uniform(-1, 1, (60, 3))
    start = Start(points, np.full((60, 3), 0.5), np.ones(60, bool), None, 1, 0.1)
    views = SimpleNamespace(time=np.linspace(0, 1, 9), near=0.1, background=(0.0, 0.0, 0.0))
    assert first_model(kind, start, views, CoarseSettings()).antialiased
    assert not first_model(kind, start, views, CoarseSettings(antialiased=False)).antialiased


@pytest.mark.parametrize(
    ("frames", "times", "kind", "size", "expected"),
    [
        (90, 90, "planes", (480, 270), 480 * 270 // 4),
        (90, 90, "static", (480, 270), 480 * 270 // 8),
        (90, 90, "nodes", (400, 400), 32_000),
        (90, 90, "planes", (200, 200), 12_000),
        (90, 90, "planes", (1280, 720), 120_000),
        (8 * 45, 45, "planes", (480, 270), 40_000),
        (8 * 45, 45, "static", (640, 360), 57_600),
    ],
)
def test_the_budget_follows_from_the_pixels(frames, times, kind, size, expected):
    views = SimpleNamespace(width=size[0], height=size[1])
    assert auto_budget(Facts(frames=frames, times=times, static=kind == "static"), views, kind) == expected
