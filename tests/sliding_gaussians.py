"""A few coloured Gaussians that slide past cameras: the views of a training that takes milliseconds a step, and models to begin with."""

from collections import OrderedDict
from dataclasses import replace

import numpy as np
import torch
from e4dgs.scene.model import Model
from e4dgs.scene.motion.planes.field import DeformationField
from e4dgs.scene.motion.static import Static
from e4dgs.scene.primitives import ConvexSet, GaussianSet
from e4dgs.scene.settings import TrainingSettings
from e4dgs.scene.views import Views

SIZE = 32
SETTINGS = TrainingSettings(
    iterations=120, sh_degree=0, densify_every=40, lr_means=4e-3, flow_every=4, patience=100, checkpoint_seconds=1e-9
)


def truth(t):
    rng = np.random.default_rng(5)
    points = rng.uniform(-0.8, 0.8, (12, 3))
    points[:6, 0] += 0.6 * t
    g = GaussianSet.from_points(points, rng.uniform(size=(12, 3)), 0, opacity=0.9)
    with torch.no_grad():
        g.log_scales.fill_(-1.4)
    return Model(g, ConvexSet.empty(6, 0), Static(), 0)


def make_views(cameras=3, times=4, size=SIZE, late=None):
    """late: by how many frames the pictures of a camera are later than their times, by its number."""
    late = late or {}
    poses, K = [], np.array([[1.125 * size, 0, size / 2], [0, 1.125 * size, size / 2], [0, 0, 1]])
    for c in range(cameras):
        angle = 0.5 * (c - 1)
        R = np.array([[np.cos(angle), 0, -np.sin(angle)], [0, 1, 0], [np.sin(angle), 0, np.cos(angle)]])
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = R, [0, 0, 4]
        poses.append(pose)
    frames = [(c, t) for c in range(cameras) for t in range(times)]
    count = len(frames)
    nxt = np.array([i + 1 if t + 1 < times else -1 for i, (_, t) in enumerate(frames)])
    views = Views(
        np.repeat(K[None], count, 0), np.array([poses[c] for c, _ in frames]), np.array([t / (times - 1) for _, t in frames]),
        np.array([c for c, _ in frames]), nxt, np.arange(count), size, size, lambda i: images[i],
    )  # fmt: skip
    images = []
    for i, (c, t) in enumerate(frames):
        color = truth((t + late.get(c, 0.0)) / (times - 1)).render(views.rasterizer_camera(i), 0.0).color
        images.append((color.clamp(0, 1) * 255).round().to(torch.uint8).numpy())
    return views


def wandering_views(frames=26, size=SIZE):
    """One camera a time, each on another side of the scene."""
    source = make_views(3, frames, size)
    chosen = np.array([(t % 3) * frames + t for t in range(frames)])
    return Views(
        source.K[chosen], source.cam_from_world[chosen], source.time[chosen], np.arange(frames), np.full(frames, -1), np.arange(frames),
        size, size, lambda i: source.load(int(chosen[i])),
    )  # fmt: skip


def fresh(views, static=False):
    rng = np.random.default_rng(0)
    points = rng.uniform(-1, 1, (60, 3))
    g = GaussianSet.from_points(points, np.full((60, 3), 0.5), 0, max_scale=0.3)
    return Model(g, ConvexSet.empty(6, 0), Static() if static else DeformationField.over(points, len(np.unique(views.time))), 0)


def there(views):
    """The same views, on the CUDA device."""
    return replace(views, device="cuda", _there=OrderedDict(), _there_bytes=0)
