"""Which seeds may move: the shares of the looks from which on, and when what moves has seeds of its own."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from e4dgs.pipeline import Artifact, Progress
from e4dgs.scene.motion.lifetimes.lifetimes import LEAST, LEAST_ALONE, Lifetimes
from e4dgs.scene.primitives import GaussianSet
from e4dgs.scene.seeds.moving.moving_seeds import MovingSeeds
from e4dgs.scene.views import Views
from e4dgs.stages.seeds import place as room
from e4dgs.stages.seeds.key_times import KEYS
from e4dgs.stages.seeds.place import LONGEST, initial_dynamic, moving_seeds
from e4dgs.stages.seeds.run import drawn
from write_artifact import write_artifact

LOOKS = 20
WIDTH = HEIGHT = LOOKS + 2
FIRST = 7  # number of the first fixed camera
HELD_OUT = 3  # frames of the moving camera, before the others


def views(fixed: bool) -> Views:
    """`LOOKS` cameras that stand, with two frames each, or as many training frames of one that moves and `HELD_OUT` others. The camera
    or frame k is moved by k pixels, so that `points` lie in its row k."""
    look = np.repeat(np.arange(LOOKS), 2) if fixed else np.array([0] * HELD_OUT + [*range(LOOKS)])
    count, blank = len(look), np.zeros((HEIGHT, WIDTH, 3), np.uint8)
    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, 1, 3] = look
    return Views(
        K=np.tile(np.eye(3), (count, 1, 1)),
        cam_from_world=poses,
        time=np.linspace(0, 1, count),
        camera=FIRST + look if fixed else np.zeros(count, int),
        next=np.full(count, -1),
        train=np.arange(0 if fixed else HELD_OUT, count),
        width=WIDTH,
        height=HEIGHT,
        load=lambda i: blank,
    )


def points() -> np.ndarray:
    """Point x appears in column x of each look; all of them at depth 1."""
    return np.array([[x + 0.5, 0.5, 1.0] for x in range(WIDTH)])


def masks() -> np.ndarray:
    """[LOOKS, H, W]: point x is seen to move in x of the looks, at most in all."""
    found = np.zeros((LOOKS, HEIGHT, WIDTH), np.uint8)
    for k in range(LOOKS):
        found[k, k, k + 1 :] = 255
    return found


def flow(folder: Path, fixed: bool = False, moving: bool = False) -> Artifact:
    """With masks of what ever moves before each fixed camera, or of moving in each frame, or of both, or of neither."""
    arrays = {"pair": np.zeros((0, 2), np.int32)}
    if moving:
        # In frames that are held out everything moves; nobody must look at them.
        arrays["moving"] = np.concatenate([np.full((HELD_OUT, HEIGHT, WIDTH), 255, np.uint8), masks()])
    if fixed:
        arrays["ever_moving"] = masks()[::-1]
    return write_artifact(folder, arrays, **({"ever_moving_cameras": [FIRST + k for k in reversed(range(LOOKS))]} if fixed else {}))


def context(flow: Artifact | None) -> SimpleNamespace:
    lines: list[str] = []
    return SimpleNamespace(inputs={"flow": flow}, log=lines.append, lines=lines, progress=Progress, settings=SimpleNamespace(budget=None))


@pytest.mark.parametrize(
    ("fixed", "moving_seeded", "first"),
    [
        (True, False, 6),  # 0.3 of 20 fixed cameras
        (True, True, 6),
        (False, True, 10),  # half of the frames, where what moves has seeds of its own
        (False, False, 1),  # a twentieth of them, where these must do
    ],
)
def test_a_seed_may_move_from_a_share_of_the_looks_on(fixed, moving_seeded, first, tmp_path):
    ctx = context(flow(tmp_path / "flow", fixed, moving=not fixed))
    dynamic = initial_dynamic(ctx, points(), views(fixed), moving_seeded)
    assert dynamic.dtype == bool and dynamic.tolist() == [x >= first for x in range(WIDTH)]
    (line,) = ctx.lines
    assert line.startswith(f"{first} of {WIDTH} seeds lie where") and ("fixed camera" in line) is fixed


def test_what_fixed_cameras_see_counts_before_masks_of_moving_pixels(tmp_path):
    ctx = context(flow(tmp_path / "flow", fixed=True, moving=True))
    assert initial_dynamic(ctx, points(), views(True), False).tolist() == [x >= 6 for x in range(WIDTH)]


SEEDS = room.PlacedSeeds(points(), points(), points(), {})


def test_without_masks_every_seed_may_move(tmp_path):
    for found in (None, flow(tmp_path / "flow")):
        ctx = context(found)
        assert initial_dynamic(ctx, points(), views(False), False).all() and not ctx.lines


@pytest.mark.parametrize(
    ("fixed", "moving", "expected"), [(False, True, "seeds"), (True, True, "seeds"), (True, False, None), (False, False, None)]
)
def test_one_camera_seeds_what_moves_where_masks_show_it(fixed, moving, expected, tmp_path, monkeypatch):
    """Also where the camera stands still: then their depth is given or assumed."""
    found = MovingSeeds(np.zeros((3, 3)), np.zeros((3, 3)), np.zeros((3, 3)), np.array([0.0, 0.0, 1.0]))
    monkeypatch.setattr(room, "camera_seeds", lambda *given: found)
    ctx = context(flow(tmp_path / "flow", fixed, moving))
    ctx.facts = {"frames": LOOKS, "times": LOOKS}
    assert moving_seeds(ctx, None, views(fixed), SEEDS, 100) is (found if expected else None)
    assert ctx.lines == (["seeds: 3 on moving objects, at 2 times"] if expected else [])


@pytest.mark.parametrize(("budget", "most"), [(None, 480 * LONGEST), (960, 480)])
def test_a_long_clip_has_more_seeds_unless_their_number_is_limited(budget, most, tmp_path, monkeypatch):
    asked = []
    monkeypatch.setattr(room, "camera_seeds", lambda *given: asked.append(given[3:5]))
    ctx = context(flow(tmp_path / "flow", moving=True))
    ctx.facts, ctx.settings.budget = {"frames": LOOKS, "times": LOOKS}, budget
    moving_seeds(ctx, None, views(False), SEEDS, 480)
    assert asked == [(480 // KEYS, most)]


@pytest.mark.parametrize(("fixed", "swept", "looks"), [(False, True, True), (True, True, False), (False, False, False)])
def test_only_before_moving_cameras_frames_show_what_is_at_rest(fixed, swept, looks, tmp_path, monkeypatch):
    """The maps of a fixed camera are of a median, behind whatever moves."""
    asked = []
    monkeypatch.setattr(room, "camera_seeds", lambda *given: asked.append(given[-1]))
    ctx = context(flow(tmp_path / "flow", moving=True))
    ctx.facts = {"frames": LOOKS, "times": LOOKS}
    known = SEEDS._replace(swept={0: np.ones((4, 6), np.float32)} if swept else None)
    moving_seeds(ctx, SimpleNamespace(fixed_cameras=fixed), views(False), known, 100)
    assert [one is not None for one in asked] == [looks]


def test_without_flow_nothing_is_seeded():
    assert moving_seeds(context(None), None, views(False), SEEDS, 100) is None


def test_seeds_of_each_time_live_around_it_and_overlap_the_next():
    time = np.array([0.0] * 4 + [0.5] * 5 + [1.0] * 6)
    rng = np.random.default_rng(0)
    velocities = rng.normal(size=(15, 3))
    sets = Lifetimes(41).around(MovingSeeds(rng.normal(size=(15, 3)), rng.uniform(size=(15, 3)), velocities, time), 1, 1.0)
    assert [len(one) for one in sets] == [4, 5, 6]
    for one, frame in zip(sets, (0.0, 20.0, 40.0)):
        assert one.times.tolist() == [frame] * len(one) and one.dynamic.all()
        presence = np.exp(-0.5 * (10 / one.log_spans.exp().detach().numpy()) ** 2)  # half way to the next
        assert (presence > 0.5).all()
    assert np.allclose(np.concatenate([one.velocities.detach().numpy() for one in sets]), velocities, atol=1e-6)


@pytest.mark.parametrize(("cameras", "shortest"), [(1, LEAST_ALONE), (2, LEAST)])
def test_seeds_at_each_time_live_longer_if_one_camera_alone_sees_them(cameras, shortest):
    """Each time is then seen from one side, and what lives for it alone fits it and nothing beside it."""
    times = np.repeat(np.linspace(0, 1, 5), 2)
    found = MovingSeeds(np.zeros((10, 3)), np.zeros((10, 3)), np.zeros((10, 3)), times)
    start = SimpleNamespace(
        moving=found, sh_degree=0, max_scale=1.0, gaussians=lambda: GaussianSet.from_points(np.ones((1, 3)), np.ones((1, 3)), 0)
    )
    _, gaussians = Lifetimes.start(start, SimpleNamespace(time=times, camera=np.arange(10) % cameras), None)
    assert np.allclose(gaussians.log_spans[1:].exp().detach().numpy(), shortest)


@pytest.mark.parametrize(("count", "expected"), [(-3, 0), (0, 0), (7, 7), (WIDTH, WIDTH), (WIDTH + 5, WIDTH)])
def test_no_more_seeds_are_drawn_than_there_is_room_for(count, expected):
    """Seeds on what moves may fill a budget alone."""
    chosen, colors = drawn(points(), points() / WIDTH, count, 0)
    assert len(chosen) == expected == len(np.unique(chosen, axis=0)) and np.array_equal(colors, chosen / WIDTH)
