"""Paths of cameras through a scene."""

from types import SimpleNamespace

import numpy as np
import pytest
from e4dgs.scene.model import Model
from e4dgs.scene.primitives import ConvexSet, GaussianSet
from e4dgs.stages.exports.camera_path import named_path


def ring(cameras: int = 6, radius: float = 3.0) -> SimpleNamespace:
    """Cameras on a circle that look at its middle, (0, 0, 5)."""
    poses = np.tile(np.eye(4), (cameras, 1, 1))
    for pose, angle in zip(poses, np.linspace(0, 2 * np.pi, cameras, endpoint=False)):
        forward = np.array([np.cos(angle), 0.0, np.sin(angle)])
        pose[:3, :3] = np.stack([np.cross([0.0, 1.0, 0.0], forward), [0.0, 1.0, 0.0], forward])
        pose[:3, 3] = -pose[:3, :3] @ (np.array([0.0, 0.0, 5.0]) - radius * forward)
    index = np.arange(cameras)
    K = np.tile([[20.0, 0, 8], [0, 20.0, 8], [0, 0, 1]], (cameras, 1, 1))
    return SimpleNamespace(cam_from_world=poses, K=K, train=index, camera=index, time=np.linspace(0, 1, cameras), width=16, height=16)


@pytest.mark.parametrize("name", ["turntable", "spiral", "capture"])
def test_a_model_without_gaussians_can_be_walked_around_too(name):
    frames = ring()
    none = np.zeros((0, 3))
    path = named_path(name, frames, Model(GaussianSet.from_points(none, none, 0), ConvexSet.empty(6, 0), None, 0), 4)
    assert path.cam_from_world.shape == (4, 4, 4) and np.isfinite(path.cam_from_world).all()
