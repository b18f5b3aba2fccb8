"""Seeds without points: the shared volume, and carving by majority."""

import numpy as np
import torch
from e4dgs.scene.seeds.carve import carve
from e4dgs.scene.seeds.volume import common_volume
from e4dgs.scene.views import Views


def ring(count=16, radius=4.0, target=(0.5, -0.2, 0.3)):
    """Cameras on a ring that look at ``target``; a white ball of radius 0.6 around it is the object."""
    target = np.asarray(target)
    poses, masks = [], []
    K = np.array([[60.0, 0, 32], [0, 60, 24], [0, 0, 1]])
    for a in np.linspace(0, 2 * np.pi, count, endpoint=False):
        centre = target + radius * np.array([np.cos(a), 0.4 * np.sin(3 * a), np.sin(a)])
        forward = (target - centre) / np.linalg.norm(target - centre)
        right = np.cross(forward, [0, -1.0, 0])
        right /= np.linalg.norm(right)
        R = np.stack([right, np.cross(forward, right), forward])
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = R, -R @ centre
        poses.append(pose)
        y, x = np.mgrid[:48, :64] + 0.5
        distance = np.linalg.norm(centre - target)
        masks.append((x - 32) ** 2 + (y - 24) ** 2 <= (60 * 0.6 / distance) ** 2)
    index = np.arange(count)
    image = np.zeros((48, 64, 3), np.uint8)
    image[...] = (200, 100, 50)
    stack = np.repeat(K[None], count, 0)
    return Views(stack, np.array(poses), index / count, index, np.full(count, -1), index, 64, 48, lambda i: image), masks


def test_the_shared_volume_is_where_axes_meet():
    views, _ = ring()
    centre, radius = common_volume(views)
    assert np.allclose(centre, [0.5, -0.2, 0.3], atol=1e-6)
    assert 1.0 < radius < 2.0  # 24 px of 60 px focal length at distance ~4.1


def test_parallel_cameras_have_a_volume_ahead():
    views, _ = ring(4)
    poses = np.repeat(np.eye(4)[None], 4, 0)
    poses[:, 0, 3] = [0, 1, 2, 3]
    views.cam_from_world = poses
    centre, radius = common_volume(views)
    assert centre[2] > 0 and np.isfinite(radius) and radius > 0


def test_carving_finds_the_ball_and_its_colour():
    views, masks = ring()
    points, colors = carve(views, masks, views.train, 500, seed=0)
    assert points.shape == (500, 3)
    distance = np.linalg.norm(points - [0.5, -0.2, 0.3], axis=1)
    assert np.quantile(distance, 0.95) < 0.8
    assert np.allclose(colors, np.array([200, 100, 50]) / 255, atol=1e-6)


def test_carving_is_deterministic_and_survives_empty_masks():
    views, masks = ring(6)
    a, b = (carve(views, masks, views.train, 50, seed=1)[0] for _ in range(2))
    assert np.array_equal(a, b)
    points, colors = carve(views, [np.zeros_like(m) for m in masks], views.train, 50, seed=1)
    assert np.isfinite(points).all() and np.allclose(colors, 0.5)


def test_views_scale_cameras_and_images_together():
    views, _ = ring(3)
    half = views.rasterizer_camera(0, 0.5)
    assert (half.width, half.height) == (32, 24)
    assert torch.allclose(half.K, torch.tensor([[30.0, 0, 16], [0, 30, 12], [0, 0, 1]]))
    assert views.target(0, 0.5).shape == (24, 32, 3)
