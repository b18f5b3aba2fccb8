"""Seeds where features found nothing, and how near to cameras nothing is: a ring of cameras around a ball in a box."""

import numpy as np
import pytest
from e4dgs.scene.seeds.colours import median_colours
from e4dgs.scene.seeds.moving.hull import VisualHull
from e4dgs.scene.seeds.near_plane import near_plane
from e4dgs.scene.seeds.outliers import trusted
from e4dgs.scene.seeds.rays import ray_seeds
from e4dgs.scene.seeds.shell import shell_seeds, surrounded
from e4dgs.scene.views import Views

WIDTH, HEIGHT, FOCAL = 64, 48, 40.0
BALL = 0.6


def ring(count=12, radius=4.0, turn=2 * np.pi, load=None) -> Views:
    """Cameras on an arc of ``turn`` radians that look at the origin."""
    poses = []
    for a in np.linspace(0, turn, count, endpoint=False):
        centre = radius * np.array([np.cos(a), 0.3 * np.sin(3 * a), np.sin(a)])
        forward = -centre / np.linalg.norm(centre)
        right = np.cross(forward, [0, -1.0, 0])
        right /= np.linalg.norm(right)
        pose = np.eye(4)
        pose[:3, :3] = np.stack([right, np.cross(forward, right), forward])
        pose[:3, 3] = -pose[:3, :3] @ centre
        poses.append(pose)
    K = np.array([[FOCAL, 0, WIDTH / 2], [0, FOCAL, HEIGHT / 2], [0, 0, 1]])
    index = np.arange(count)
    blank = np.full((HEIGHT, WIDTH, 3), 100, np.uint8)
    stacked = np.repeat(K[None], count, 0)
    return Views(stacked, np.array(poses), 0.0 * index, index, np.full(count, -1), index, WIDTH, HEIGHT, load or (lambda i: blank))


def silhouettes(views: Views) -> list[np.ndarray]:
    """The ball of radius `BALL` around the origin, exactly."""
    y, x = np.mgrid[:HEIGHT, :WIDTH] + 0.5
    ray = np.stack([(x - WIDTH / 2) / FOCAL, (y - HEIGHT / 2) / FOCAL, np.ones_like(x)], -1)
    ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
    distance = np.linalg.norm(views.centres(), axis=1)
    return [d * np.sqrt(np.maximum(1 - ray[..., 2] ** 2, 0)) <= BALL for d in distance]


def plane(count=300, seed=0) -> np.ndarray:
    """Points on the tilted plane z = 0.3 x, behind the origin for a camera ahead of it."""
    x, y = np.random.default_rng(seed).uniform(-2, 2, (2, count))
    return np.stack([x, y, 0.3 * x], 1)


def test_rays_end_on_the_plane_that_points_lie_on():
    views = ring(3, turn=0.6)
    views.cam_from_world[:] = np.eye(4)
    views.cam_from_world[:, 2, 3] = 4.0
    seeds = ray_seeds(views, plane(), views.train, 600, seed=0)
    assert 300 < len(seeds) <= 700
    inner = np.abs(seeds[:, :2]).max(1) < 1.8  # not beyond the points
    assert inner.sum() > 100 and np.abs(seeds[inner, 2] - 0.3 * seeds[inner, 0]).max() < 0.15
    assert np.array_equal(seeds, ray_seeds(views, plane(), views.train, 600, seed=0))


def test_all_rays_start_where_no_point_is_near_however_little_that_is():
    """Most of the picture has a point every few pixels; the right fifth has none but gets all the seeds."""
    views = ring(3, turn=0.6)
    views.cam_from_world[:] = np.eye(4)
    views.cam_from_world[:, 2, 3] = 4.0
    y, x = np.mgrid[:HEIGHT, : round(0.8 * WIDTH)]
    rays = np.stack([(x + 0.5 - WIDTH / 2) / FOCAL, (y + 0.5 - HEIGHT / 2) / FOCAL], -1).reshape(-1, 2)
    points = np.concatenate([4.0 * rays, np.zeros((len(rays), 1))], 1)
    seeds = ray_seeds(views, points, views.train[:1], 150, seed=0)
    assert len(seeds) > 0.7 * 150 and (views.project(0, seeds).x >= 0.78 * WIDTH).mean() > 0.9


def test_no_rays_from_what_is_skipped_and_none_where_little_is_known():
    views = ring(3, turn=0.6)
    left = np.zeros((HEIGHT, WIDTH), bool)
    left[:, : WIDTH // 2] = True
    seeds = ray_seeds(views, plane(), views.train[:1], 400, seed=0, skip=[left])
    assert len(seeds) and (views.project(0, seeds).x >= WIDTH // 2).all()
    assert ray_seeds(views, plane(5), views.train, 400, seed=0).shape == (0, 3)


def test_the_hull_is_the_ball_and_nothing_is_in_empty_masks():
    views = ring()
    masks = silhouettes(views)
    seeds = VisualHull(views).points(masks, views.train, 500, 0)
    distance = np.linalg.norm(seeds, axis=1)
    assert len(seeds) == 500 and np.quantile(distance, 0.9) < 1.6 * BALL and np.quantile(distance, 0.1) > 0.7 * BALL
    assert VisualHull(views).points([np.zeros_like(m) for m in masks], views.train, 500, 0).shape == (0, 3)


def test_a_median_is_not_coloured_by_what_hides_a_point_from_some():
    red, grey = np.zeros((HEIGHT, WIDTH, 3), np.uint8), np.full((HEIGHT, WIDTH, 3), 102, np.uint8)
    red[..., 0] = 255
    views = ring(7, load=lambda i: red if i in (2, 5) else grey)
    points = np.array([[0.0, 0, 0], [0.1, 0, 0.2], [0, 99.0, 0]])
    colors, seen = median_colours(views, points, views.train)
    assert seen.tolist() == [7, 7, 0]
    assert np.allclose(colors[:2], 0.4, atol=1e-6) and np.allclose(colors[2], 0.5)
    only = [np.full((HEIGHT, WIDTH), i in (2, 5)) for i in range(7)]
    assert np.allclose(median_colours(views, points[:1], views.train, only)[0], [[1, 0, 0]])


def test_points_that_stand_alone_or_at_a_camera_are_left_out():
    rng = np.random.default_rng(0)
    views = ring()
    room = rng.uniform(-1, 1, (400, 3))
    face = views.centres()[0] * 0.99
    keep = trusted(np.concatenate([room, [[0, 30.0, 0]], np.tile(face, (8, 1)) + rng.normal(0, 1e-3, (8, 3))]), views.centres())
    assert keep[:400].mean() > 0.98 and not keep[400:].any()


def test_a_shell_surrounds_the_cameras_where_they_surround_something():
    views = ring()
    assert surrounded(views) and not surrounded(ring(turn=0.8))
    corners = 3.0 * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    seeds = shell_seeds(views, corners, 200, seed=0)
    outer = np.maximum(np.abs(seeds).max(1) / 3, np.linalg.norm(seeds[:, [0, 2]], axis=1) / 4)
    assert len(seeds) == 200 and (outer > 0.69).all()  # none inside
    flat = ring(4)
    flat.cam_from_world[:] = np.eye(4)
    assert shell_seeds(flat, np.zeros((4, 3)), 200, seed=0).shape == (0, 3)


@pytest.mark.parametrize(("nearest", "expected"), [(0.5, 0.25), (3.0, 0.8)])
def test_nothing_is_drawn_nearer_than_half_of_the_nearest_point(nearest, expected):
    """At most a fifth of the viewing distance of 4; a lone wrong match at the lens does not count."""
    views = ring(1, radius=4.0)
    rng = np.random.default_rng(0)
    far, close = (rng.uniform([-0.1, -0.1, z], [0.1, 0.1, z], (count, 3)) for z, count in ((4.0, 200), (nearest, 20)))
    cam = np.concatenate([far, close, [[0, 0, 0.02]]])
    pose = views.cam_from_world[0]
    points = (cam - pose[:3, 3]) @ pose[:3, :3]
    assert near_plane(views, points) == pytest.approx(expected, rel=0.05)


def test_few_points_say_nothing_about_what_is_near():
    views = ring(2)
    assert near_plane(views, np.zeros((3, 3))) == pytest.approx(0.05 * views.viewing_distance(np.zeros((3, 3))))
