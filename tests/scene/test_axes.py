"""Turns of exported scenes: right is right and up is up, and what a camera that turns with the scene sees is unchanged, SH included."""

import itertools

import numpy as np
import pytest
import torch
from e4dgs.rasterizer import Camera, Gaussians, rasterize
from e4dgs.scene.formats.axes import AXES, Turn, nearest_axis, turned, unit_vector
from e4dgs.scene.formats.sh_rotation import mixes, rotated_sh
from scipy.spatial.transform import Rotation
from scipy.special import sph_harm_y


def gaussians(degree: int = 3) -> Gaussians:
    generator = torch.Generator().manual_seed(3)
    draw = lambda *shape: torch.randn(*shape, generator=generator)  # noqa: E731
    scales = torch.exp(0.4 * draw(100, 3) - 2.0)
    return Gaussians(draw(100, 3) * 0.5, draw(100, 4), scales, torch.full((100,), 0.7), sh=0.4 * draw(100, (degree + 1) ** 2, 3))


@pytest.mark.parametrize(("before", "after"), itertools.product(AXES, AXES))
def test_a_turn_is_a_rotation_that_brings_one_axis_to_the_other(before, after):
    turn = Turn(before, after)
    assert np.array_equal(turn.matrix @ unit_vector(before), unit_vector(after)) and np.linalg.det(turn.matrix) == pytest.approx(1)
    assert np.array_equal(np.abs(turn.matrix).sum(0), np.ones(3)), "axes go to axes, exactly"
    np.testing.assert_allclose(Rotation.from_quat(turn.quat[[1, 2, 3, 0]]).as_matrix(), turn.matrix, atol=1e-15)
    assert (turn.degrees == 0) == (before == after) and ("all axes are those of the capture" in str(turn)) == (before == after)


def test_right_stays_right_where_up_and_down_change_places():
    assert np.array_equal(Turn("-Y", "Y").matrix, np.diag([1.0, -1, -1])), "right, down, front becomes right, up, back"
    assert np.array_equal(Turn("Z", "Y").matrix @ [1, 0, 0], [1, 0, 0])
    made = gaussians()
    assert Turn("Z", "Z")(made) is made, "nothing is rounded where nothing turns"


@pytest.mark.parametrize(("before", "after"), itertools.product(AXES, AXES))
def test_levelling_brings_a_direction_upright_and_back(before, after):
    up = 2 * unit_vector(before) + np.array([0.3, -0.5, 0.4])
    turn, made = Turn.levelling(up, after), gaussians()
    np.testing.assert_allclose(turn.matrix @ up, np.linalg.norm(up) * unit_vector(after), atol=1e-12)
    np.testing.assert_allclose(turn.matrix @ turn.matrix.T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(Rotation.from_quat(turn.quat[[1, 2, 3, 0]]).as_matrix(), turn.matrix, atol=1e-12)
    assert "--up capture" in str(turn) and Turn.levelling(unit_vector(before), after) == Turn(before, after)
    torch.testing.assert_close(turn.back(turn(made)).sh, made.sh, atol=1e-5, rtol=0)
    torch.testing.assert_close(turn.back(turn(made)).means, made.means, atol=1e-5, rtol=0)


@pytest.mark.parametrize("axis", AXES)
def test_the_nearest_axis(axis):
    assert nearest_axis(unit_vector(axis) + 0.3 * np.array([0.3, -0.5, 0.4])) == axis


def real_harmonics(directions: np.ndarray) -> np.ndarray:
    """[n, 16] from scipy's complex ones: for m < 0 sqrt(2) times the imaginary part of |m|, for m > 0 of the real part, with the
    Condon-Shortley phase, which is the sign convention of 3DGS."""
    polar, azimuth = np.arccos(directions[:, 2]), np.arctan2(directions[:, 1], directions[:, 0])
    columns = []
    for degree in range(4):
        for m in range(-degree, degree + 1):
            value = sph_harm_y(degree, abs(m), polar, azimuth)
            columns.append(value.real if m == 0 else 2**0.5 * (value.real if m > 0 else value.imag))
    return np.stack(columns, 1)


@pytest.mark.parametrize("seed", range(4))
def test_rotated_coefficients_have_the_same_values_in_rotated_directions(seed):
    rng = np.random.default_rng(seed)
    rotation = Rotation.random(rng=rng).as_matrix() if seed else Turn("Z", "-Y").matrix
    directions = rng.normal(size=(200, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    sh = torch.from_numpy(rng.normal(size=(5, 16, 3)))
    before = np.einsum("dk,nkc->dnc", real_harmonics(directions), sh.numpy())
    after = np.einsum("dk,nkc->dnc", real_harmonics(directions @ rotation.T), rotated_sh(sh, rotation).numpy())
    np.testing.assert_allclose(after, before, atol=1e-12)
    for one in mixes(16, rotation):
        np.testing.assert_allclose(one @ one.T, np.eye(len(one)), atol=1e-13)


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_a_camera_that_turns_with_the_scene_sees_the_same(degree):
    made, rotation = gaussians(degree), Rotation.from_rotvec([0.7, -1.1, 0.4]).as_matrix()
    pose, turning = torch.eye(4), torch.eye(4)
    pose[:3, 3], turning[:3, :3] = torch.tensor([0.2, -0.1, 3.0]), torch.from_numpy(rotation)
    K = torch.tensor([[80.0, 0, 32], [0, 80, 32], [0, 0, 1]])
    before = rasterize(Camera(K, pose, 64, 64), made, None, torch.zeros(3)).color
    after = rasterize(Camera(K, pose @ turning.T, 64, 64), turned(made, rotation), None, torch.zeros(3)).color
    assert before.std() > 0.1
    torch.testing.assert_close(after, before, atol=2e-4, rtol=0)
