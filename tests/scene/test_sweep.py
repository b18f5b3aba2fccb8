"""Depth by plane sweep in a rendered room, and the loss that holds a model to it."""

import numpy as np
import pytest
import torch
from e4dgs.scene.losses.measured_depth import LARGEST, MeasuredDepth, depth_difference
from e4dgs.scene.seeds.sweep import beside, plane_sweep, points_of
from e4dgs.scene.views import Views
from rendered_room import HEIGHT, WIDTH, rendered_room


@pytest.fixture(scope="module")
def room():
    """Views of seven cameras in a textured room, their pictures, the true depth of each, and a few true points."""
    views, pictures, truths = rendered_room(7)
    rng = np.random.default_rng(0)
    x, y = rng.integers(0, WIDTH, 40), rng.integers(0, HEIGHT, 40)
    z = truths[0].depth[y, x]
    ray = np.stack([(x + 0.5 - views.K[0, 0, 2]) / views.K[0, 0, 0], (y + 0.5 - views.K[0, 1, 2]) / views.K[0, 1, 1], np.ones(40)], 1)
    pose = views.cam_from_world[0]
    points = (ray * z[:, None] - pose[:3, 3]) @ pose[:3, :3]
    return views, pictures, [truth.depth for truth in truths], points


@pytest.fixture(scope="module")
def swept(room):
    """The maps of all pictures, and what was told of the progress."""
    views, pictures, _, points = room
    done: list[int] = []
    return plane_sweep(views, list(views.train), pictures, points, done.append), done


def test_most_of_what_it_tells_is_right(room, swept):
    views, _, depths, _ = room
    maps, done = swept
    assert sum(done) == len(views.train) and len(maps) == len(views.train)
    known = np.mean([(one.inverse > 0).mean() for one in maps])
    assert known > 0.25
    off = []
    for one in maps:
        y, x = np.nonzero(one.inverse)
        off.append(np.abs(one.inverse[y, x] * depths[one.frame][y, x] - 1))
    off = np.concatenate(off)
    assert np.median(off) < 0.01 and (off < 0.05).mean() > 0.95
    world, frame, at = points_of(maps, views)
    for i in views.train:
        mine = frame == i
        shown, x, y, _ = views.project(int(i), world[mine])
        assert len(shown) == mine.sum() and np.abs(np.stack([x, y], 1) + 0.5 - at[mine][shown]).max() <= 1


def test_gains_and_offsets_of_cameras_make_no_difference(room, swept):
    views, pictures, _, points = room
    rng = np.random.default_rng(1)
    changed = [(p * rng.uniform(0.7, 0.9) + rng.uniform(0, 20)).astype(np.uint8) for p in pictures]
    one, two = swept[0], plane_sweep(views, list(views.train), changed, points)
    before, after = (np.mean([(m.inverse > 0).mean() for m in maps]) for maps in (one, two))
    assert after > 0.9 * before


def test_without_points_or_without_parallax_nothing_is_told(room):
    views, pictures, _, points = room
    assert plane_sweep(views, list(views.train), pictures, points[:0]) == []
    still = Views(views.K, views.cam_from_world[[0] * 7], views.time, views.camera, views.next, views.train, WIDTH, HEIGHT, views.load)
    assert beside(still, list(views.train), 0, points) == []
    assert plane_sweep(still, list(views.train), pictures, points) == []


def test_a_picture_without_texture_tells_nothing(room):
    views, pictures, _, points = room
    grey = [np.full_like(p, 128) for p in pictures]
    assert all(not one.inverse.any() for one in plane_sweep(views, list(views.train), grey, points))


def test_the_loss_is_the_clamped_difference_where_depth_is_known():
    unit, alpha = 4.0, torch.full((2, 3), 0.8)
    measured = torch.tensor([[0.25, 0.0, 0.25], [0.5, 0.25, 0.25]])
    depth = 0.8 * torch.tensor([[4.0, 4.0, 5.0], [4.0, 3.9, 4.0]])
    alpha[1, 2] = 0.3  # no surface
    loss = depth_difference(depth, alpha, measured, None, unit)
    expected = (0 + 0 + abs(4 / 5 - 1) + LARGEST + (4 / 3.9 - 1) + 0) / 6
    assert float(loss) == pytest.approx(expected, rel=1e-5)
    without = depth_difference(depth, alpha, measured, torch.tensor([[False, False, True]]), unit)
    assert float(without) == pytest.approx((LARGEST + (4 / 3.9 - 1)) / 6, rel=1e-5)


def test_maps_are_resized_and_frames_without_one_are_unknown():
    maps = MeasuredDepth({7: torch.tensor([[0.25, 0.5]])}, 1.0)
    assert maps.of(8, 2, 4) is None and maps.moving(7) is None
    assert torch.equal(maps.of(7, 2, 4), torch.tensor([[0.25, 0.25, 0.5, 0.5]] * 2))


def test_gradients_of_the_loss_agree_with_central_differences():
    draw = torch.Generator().manual_seed(0)
    depth = (3 + torch.rand(4, 5, generator=draw, dtype=torch.float64)).requires_grad_()
    alpha = (0.6 + 0.3 * torch.rand(4, 5, generator=draw, dtype=torch.float64)).requires_grad_()
    measured = 0.2 + 0.05 * torch.rand(4, 5, generator=draw, dtype=torch.float64)
    assert torch.autograd.gradcheck(lambda d, a: depth_difference(d, a, measured, None, 1.0), (depth, alpha), eps=1e-6, atol=1e-8)
