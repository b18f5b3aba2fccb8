"""Posed frames as training sees them: where points of the world appear in a picture, and pictures that threads ask for at once."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from threading import Barrier

import numpy as np
import pytest
import torch
from e4dgs.scene.views import Views

WIDTH, HEIGHT, NEAR = 20, 12, 0.5
FOCAL, CENTRE = (16.0, 32.0), (9.0, 7.0)  # px; powers of two keep borders of pixels exact, and the centre is not that of the picture


def two_views() -> Views:
    """Frame 0 has the world's axes; frame 1 is turned and moved."""
    c, s = np.cos(0.7), np.sin(0.7)
    poses = np.tile(np.eye(4), (2, 1, 1))
    poses[1, :3, :3] = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]) @ np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
    poses[1, :3, 3] = [0.3, -0.2, 1.5]
    K = np.tile([[FOCAL[0], 0, CENTRE[0]], [0, FOCAL[1], CENTRE[1]], [0, 0, 1]], (2, 1, 1))
    index, blank = np.arange(2), np.zeros((HEIGHT, WIDTH, 3), np.uint8)
    return Views(K, poses, index / 2, index, np.full(2, -1), index, WIDTH, HEIGHT, lambda i: blank, near=NEAR)


def lifted(views: Views, i: int, places: np.ndarray, depth: np.ndarray) -> np.ndarray:
    """World positions [n, 3] of ``places`` [n, 2] px of frame ``i`` at ``depth`` [n]."""
    ray = np.concatenate([(places - CENTRE) / FOCAL, np.ones((len(places), 1))], 1)
    return (ray * depth[:, None] - views.cam_from_world[i, :3, 3]) @ views.cam_from_world[i, :3, :3]


@pytest.mark.parametrize("i", [0, 1])
def test_centres_of_pixels_fall_into_their_pixels(i):
    views = two_views()
    y, x = (axis.ravel() for axis in np.mgrid[:HEIGHT, :WIDTH])
    depth = np.random.default_rng(0).uniform(NEAR + 0.1, 9, len(x))
    found = views.project(i, lifted(views, i, np.stack([x, y], 1) + 0.5, depth))
    assert found.point.tolist() == list(range(WIDTH * HEIGHT)), "in the order of the points"
    assert np.array_equal(found.x, x) and np.array_equal(found.y, y) and np.allclose(found.depth, depth)
    assert all(np.issubdtype(values.dtype, np.integer) for values in found[:3]), "they serve as indices"


def test_pixels_and_the_picture_own_their_left_and_upper_borders():
    views, e = two_views(), 1e-6
    inside = {(3 - e, 5): (2, 5), (3, 5): (3, 5), (3, 5 - e): (3, 4), (0, 0): (0, 0), (WIDTH - e, HEIGHT - e): (WIDTH - 1, HEIGHT - 1)}
    outside = [(-e, 2), (WIDTH, 3), (3, HEIGHT), (3, -e)]
    places = np.array([*outside, *inside], float)
    found = views.project(0, lifted(views, 0, places, np.ones(len(places))))
    assert found.point.tolist() == list(range(len(outside), len(places)))
    assert list(zip(found.x, found.y)) == list(inside.values())


def test_what_is_behind_too_near_or_unknown_is_not_shown():
    """All points but the last lie on one ray, which would meet the picture behind the camera too."""
    depth = np.array([2.0, -2.0, NEAR, NEAR + 1e-9, 0.0, -1e-12, 7.0])
    views = two_views()
    points = np.concatenate([lifted(views, 0, np.tile([9.5, 7.5], (len(depth), 1)), depth), np.full((1, 3), np.nan)])
    found = views.project(0, points)
    assert found.point.tolist() == [0, 3, 6] and found.depth.tolist() == depth[[0, 3, 6]].tolist()
    assert [len(values) for values in views.project(0, np.zeros((0, 3)))] == [0, 0, 0, 0]


def test_a_picture_that_two_threads_load_at_once_is_kept_once():
    views, both = two_views(), Barrier(2, timeout=20)

    def load(i: int) -> np.ndarray:
        both.wait()
        return np.full((HEIGHT, WIDTH, 3), i, np.uint8)

    views.load = load
    with ThreadPoolExecutor(2) as pool:
        found = list(pool.map(views.target, (1, 1)))
    assert all(float(one.mean()) == pytest.approx(1 / 255) for one in found)
    assert views._bytes == HEIGHT * WIDTH * 3 and len(views._images) == 1


def test_edges_are_kept_within_the_same_budget_as_pictures(monkeypatch):
    views, made = two_views(), []
    views.stored_edges = lambda i: made.append(i) or np.full((HEIGHT, WIDTH), 51 * (i + 1), np.uint8)
    assert [float(views.edges(i).mean()) for i in (0, 1, 0, 1)] == pytest.approx([0.2, 0.4, 0.2, 0.4]) and made == [0, 1]
    assert tuple(views.edges(0, 0.5).shape) == (HEIGHT // 2, WIDTH // 2)
    monkeypatch.setattr("e4dgs.scene.views.CACHE_BYTES", HEIGHT * WIDTH)
    for i in (0, 1):
        views.target(i), views.edges(i)
    assert views._bytes <= HEIGHT * WIDTH and len(views._images) == 1


def test_a_device_counts_as_what_it_is_called():
    window = two_views()
    window.load_alpha = lambda i: np.pad(np.full((2, 2), 255, np.uint8), ((3, HEIGHT - 5), (3, WIDTH - 5)))
    same = replace(window, device=torch.device("cpu"))
    assert same.window(0) == window.window(0) is not None
