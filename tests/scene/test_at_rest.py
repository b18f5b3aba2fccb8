"""Pixels of a mask that show the static scene after all are told from those that move, by what other frames saw there."""

from types import SimpleNamespace

import numpy as np
import pytest
from e4dgs.scene.seeds.moving.at_rest import StaticScene

WIDTH, HEIGHT, FOCAL, WALL, NEAR, FRAMES = 160, 120, 140.0, 4.0, 2.0, 9
RIM = 6  # px by which the mask is too wide


def texture(x: np.ndarray, y: np.ndarray, phase: float) -> np.ndarray:
    """[h, w, 3] in [0, 1]."""
    waves = [np.sin(9 * x + k + phase) * np.sin(7 * y + 2 * k - phase) + np.sin(23 * x * (k + 1) / 3 + phase) for k in range(3)]
    return np.stack([0.5 + 0.2 * wave for wave in waves], -1)


class Scene:
    """A wall, in front of it a square that crosses the picture while the camera moves sideways. shade: factor on the wall's colour in the
    middle of the last frame's picture."""

    def __init__(self, shade: float = 1.0) -> None:
        K = np.array([[FOCAL, 0, WIDTH / 2], [0, FOCAL, HEIGHT / 2], [0, 0, 1.0]])
        self.poses = np.tile(np.eye(4), (FRAMES, 1, 1))
        self.poses[:, 0, 3] = -0.06 * np.arange(FRAMES)
        x, y = np.meshgrid((np.arange(WIDTH) + 0.5 - WIDTH / 2) / FOCAL, (np.arange(HEIGHT) + 0.5 - HEIGHT / 2) / FOCAL)
        self.pictures, self.object, self.mask = [], [], []
        for k in range(FRAMES):
            centre = 0.06 * k
            wall = texture(x * WALL + centre, y * WALL, 0.0)
            if k == FRAMES - 1:
                wall[HEIGHT // 2 :] *= shade
            u, v = x * NEAR + centre - (0.2 * k - 0.7), y * NEAR
            inside = (np.abs(u) < 0.25) & (np.abs(v) < 0.3)
            self.pictures.append(np.round(255 * np.where(inside[..., None], texture(3 * u, 3 * v, 2.0), wall)).astype(np.uint8))
            self.object.append(inside)
            wide = np.zeros_like(inside)
            rows, columns = np.nonzero(inside)
            wide[max(rows.min() - RIM, 0) : rows.max() + RIM + 1, max(columns.min() - RIM, 0) : columns.max() + RIM + 1] = True
            self.mask.append(wide)
        self.views = SimpleNamespace(
            K=np.tile(K, (FRAMES, 1, 1)),
            cam_from_world=self.poses,
            time=np.linspace(0, 1, FRAMES),
            width=WIDTH,
            height=HEIGHT,
            load=lambda i: self.pictures[i],
        )
        self.inverse = {k: np.where(self.mask[k], 0, 1 / WALL).astype(np.float32) for k in range(FRAMES)}


@pytest.mark.parametrize("k", [2, 4, 6])
def test_the_rim_of_a_mask_is_the_wall_and_its_inside_is_not(k):
    scene = Scene()
    shown = StaticScene(scene.views, scene.inverse).shown(k)
    rim = scene.mask[k] & ~scene.object[k]
    assert shown[rim].mean() > 0.8
    assert shown[scene.object[k]].mean() < 0.03


def test_a_wall_that_looks_otherwise_now_is_not_what_others_saw():
    alike, darker = (StaticScene(s.views, s.inverse).shown(FRAMES - 1)[HEIGHT // 2 :, : WIDTH // 3].mean() for s in (Scene(), Scene(0.5)))
    assert alike > 0.8 and darker < 0.05


def test_nothing_is_known_that_only_one_frame_saw():
    scene = Scene()
    assert not StaticScene(scene.views, {0: scene.inverse[0]}).shown(4).any()
    assert not StaticScene(scene.views, {4: scene.inverse[4], 0: scene.inverse[0]}).shown(4).any()
