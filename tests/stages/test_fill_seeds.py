"""Where the Gaussians of a rig begin: few features are matched, and yet no wall is without seeds, nor what moves."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from e4dgs.pipeline import Context
from e4dgs.scene.motion.kinds import choose
from e4dgs.scene.seeds.colours import mean_colour
from e4dgs.scene.seeds.near_plane import near_plane
from e4dgs.scene.seeds.path_width import path_width
from e4dgs.scene.views import Views
from e4dgs.stages.coarse.defaults import WIDE_PATH, auto_sh_degree
from e4dgs.stages.facts import Facts
from e4dgs.stages.seeds.defaults import auto_seeds
from e4dgs.stages.seeds.fill import Swept, fill_seeds, middle_frames
from e4dgs.stages.seeds.place import SWEPT_SHARE, load_seeds
from e4dgs.stages.seeds.settings import SeedsSettings
from e4dgs.stages.shared.dataset import load_frameset, load_views
from e4dgs.stages.shared.defaults import auto_budget, one_way
from factory import Options, make, render, write_panoptic
from run_stage import run_frames

COUNT = 3000


@pytest.fixture(scope="module")
def rig(tmp_path_factory):
    """Context, frames and views of seven cameras in a textured room in which a box and a ball move; the capture as it was made; seeds."""
    made = make(Options(rig="arc", backdrop="room", cameras=7, times=3, width=160, height=120, samples=2, fov_degrees=60))
    folder = tmp_path_factory.mktemp("rig")
    capture = write_panoptic(made, folder / "capture")
    ran = run_frames(folder / "capture", folder)
    inputs = {"frames": ran.artifact, "poses": None, "flow": None}
    lines: list[str] = []
    context: Context = replace(ran.context, inputs=inputs, settings=SeedsSettings(), log=lines.append)
    frames = load_frameset(inputs, context.capture.root)
    views = load_views(frames, None)
    return context, frames, views, capture, load_seeds(context, frames, views, COUNT)


def test_every_part_of_each_picture_has_seeds_at_about_its_depth(rig):
    _, _, views, capture, seeds = rig
    assert 30 <= len(seeds.trusted) < 0.5 * COUNT < len(seeds.points) == len(seeds.colors) <= 1.1 * COUNT
    off, filled = [], []
    for i in middle_frames(views)[::2]:
        t, camera = views.time[i], views.camera[i]
        (view,) = [v for v in capture.views if (v.time, v.camera_index) == (t, camera)]
        depth = render(capture.synthetic.scene, view.camera, view.time, samples=1).depth
        _, x, y, z = views.project(int(i), seeds.points)
        off.append(np.abs(z / depth[y, x] - 1))
        blocks = np.zeros((6, 8), bool)
        blocks[y // 20, x // 20] = True
        filled.append(blocks.mean())
    assert min(filled) > 0.9
    assert np.median(np.concatenate(off)) < 0.15


def test_what_a_single_camera_sees_has_seeds_too(rig, tmp_path):
    """Two cameras are turned away, each to a part of the room that no other camera shows."""
    context, frames, views, _, _ = rig
    turned = list(middle_frames(views)[[0, -1]])
    points = load_seeds(context, frames, views, COUNT).trusted
    poses = views.cam_from_world.copy()
    for i, angle in zip(turned, (1.2, -1.2)):
        about = np.eye(4)
        about[0, 0] = about[2, 2] = np.cos(angle)
        about[0, 2], about[2, 0] = np.sin(angle), -np.sin(angle)
        poses[i] = about @ poses[i]
    away = replace(views, cam_from_world=poses, near=views.near)
    shown = {int(i): away.project(int(i), points)[0] for i in turned}
    if min(len(s) for s in shown.values()) < 6:  # points on the part that they do show
        points = np.concatenate([points, *(in_front_of(away, int(i)) for i in turned)])
    seeds, colors = fill_seeds(context, frames, away, points, COUNT)
    for i in turned:
        alone = away.project(int(i), seeds)[0]
        others = np.concatenate([away.project(int(j), seeds)[0] for j in middle_frames(views) if j != i])
        assert len(np.setdiff1d(alone, others)) > 50
    assert len(seeds) == len(colors) <= COUNT


def in_front_of(views, i):
    """Twenty points that frame ``i`` shows."""
    at = np.stack(np.meshgrid(np.linspace(-0.4, 0.4, 5), np.linspace(-0.3, 0.3, 4)), -1).reshape(-1, 2)
    pose = views.cam_from_world[i]
    return (np.concatenate([3 * at, np.full((20, 1), 3.0)], 1) - pose[:3, 3]) @ pose[:3, :3]


@pytest.mark.parametrize(("known", "expected"), [(0.1, 0.15), (0.2, 0.3), (0.5, SWEPT_SHARE)])
def test_a_sweep_that_knows_few_depths_leaves_seeds_for_the_other_pixels(rig, monkeypatch, known, expected):
    context, frames, views, _, _ = rig
    far = np.tile([[1e3, 1e3, 1e3]], (5 * COUNT, 1)) + np.arange(5 * COUNT)[:, None]
    swept = Swept(far, np.full(far.shape, 0.5), {}, known)
    monkeypatch.setattr("e4dgs.stages.seeds.place.sweep", lambda *given: swept)
    seeds = load_seeds(context, frames, views, COUNT)
    assert (seeds.points[:, 0] >= 1e3).sum() == round(expected * COUNT)


def test_near_plane_and_background_follow_from_the_capture(rig):
    views, trusted = rig[2], rig[4].trusted
    near = near_plane(views, trusted)
    nearest = min(np.quantile(views.project(int(i), trusted).depth, 0.05) for i in views.train)
    assert 0.02 * views.viewing_distance(trusted) < near < nearest
    assert np.allclose(mean_colour(views), np.mean([views.target(int(i)).numpy().mean((0, 1)) for i in views.train], 0), atol=0.01)


def test_a_rig_gets_a_budget_for_a_room(rig):
    views = rig[2]
    rig, walk = Facts(frames=4 * 12, times=12), Facts(frames=90, times=90)
    assert rig.rig and not walk.rig and not Facts(frames=3 * 12, times=12).rig
    assert auto_budget(rig, views, "planes") == 40_000
    assert auto_budget(walk, views, "planes") == 12_000
    assert auto_seeds(rig, 40_000) == 20_000 and auto_seeds(walk, 12_000) == 8000


@pytest.mark.parametrize(
    ("size", "budget", "seeds"), [((160, 120), 12_000, 8000), ((480, 270), 48_600, 24_300), ((1920, 1080), 160_000, 40_000)]
)
def test_along_a_path_seeds_are_half_of_a_larger_budget(size, budget, seeds):
    views, walk = SimpleNamespace(width=size[0], height=size[1]), Facts(frames=90, times=90, pairs=89)
    assert one_way(walk) and auto_budget(walk, views, "planes") == budget and auto_seeds(walk, budget) == seeds


@pytest.mark.parametrize(
    "other",
    [
        {"pairs": 0},  # each frame from another side
        {"static": True},
        {"alpha": True},  # an object alone: its silhouettes are carved
        {"times": 90 // 4},  # a rig
        {"fixed_cameras": True, "cameras": 2},
    ],
)
def test_other_captures_keep_their_seeds_budget_and_degree(other):
    facts = Facts(**({"frames": 90, "times": 90, "pairs": 89} | other))
    assert not one_way(facts)
    views = SimpleNamespace(width=480, height=270)
    if not facts.rig:
        assert auto_seeds(facts, 32_400) == 8000 and auto_budget(facts, views, choose("planes", facts)) == 480 * 270 // (
            8 if facts.static else 4
        )
        assert auto_sh_degree(facts, width=0.0) == 2


def test_a_camera_that_stands_still_is_one_way_and_tells_nothing_of_directions():
    facts = Facts(frames=90, times=90, pairs=89, cameras=1, fixed_cameras=True)
    assert one_way(facts) and auto_sh_degree(facts, width=0.0) == 0


@pytest.mark.parametrize(("width", "degree"), [(0.0, 1), (WIDE_PATH - 1, 1), (WIDE_PATH + 1, 2)])
def test_the_degree_follows_the_width_of_the_path(width, degree):
    assert auto_sh_degree(Facts(frames=90, times=90, pairs=89), width) == degree
    assert auto_sh_degree(Facts(frames=4 * 12, times=12), width) == 1, "a rig"


@pytest.mark.parametrize(("arc", "turned"), [(20.0, False), (100.0, False), (100.0, True)])
def test_the_width_of_a_path_is_the_angle_under_which_a_point_sees_it(arc, turned):
    """Cameras on an arc about the points. If a part of them looks away, it does not count."""
    centres = np.array([[np.sin(a), 0, -np.cos(a)] for a in np.radians(np.linspace(-arc / 2, arc / 2, 41))])
    poses = np.tile(np.eye(4), (41, 1, 1))
    for k, centre in enumerate(centres):
        forward = -centre if not turned or abs(k - 20) <= 10 else centre
        poses[k, :3, :3] = np.stack([np.cross([0, 1, 0], forward), [0, 1, 0], forward])
        poses[k, :3, 3] = -poses[k, :3, :3] @ centre
    K, index = np.array([[40.0, 0, 24], [0, 40, 24], [0, 0, 1]]), np.arange(41)
    views = Views(np.tile(K, (41, 1, 1)), poses, index / 40, index * 0, index, index, 48, 48, lambda i: np.zeros((48, 48, 3), np.uint8))
    points = np.random.default_rng(0).uniform(-0.02, 0.02, (30, 3))
    assert path_width(views, points) == pytest.approx(arc / 2 if turned else arc, abs=2)
