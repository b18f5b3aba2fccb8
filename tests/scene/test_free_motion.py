"""Primitives with a life of their own: where they are, when they fade, and that all of it can be learned and saved."""

import math

import numpy as np
import pytest
import torch
from e4dgs.rasterizer import Camera
from e4dgs.scene.model import Model
from e4dgs.scene.motion.free import FreeMotion, turned_by
from e4dgs.scene.motion.interface import Rest
from e4dgs.scene.primitives import ALWAYS, LIFE, ConvexSet, GaussianSet, Life
from e4dgs.scene.rotation import quats_to_matrices
from e4dgs.scene.training.control.density import measure_responsibility, survivors
from e4dgs.scene.views import Views

TIMES = 11


def life(n: int, seed: int = 0) -> Life:
    draw = torch.Generator().manual_seed(seed)
    return Life(
        torch.rand(n, generator=draw, dtype=torch.float64) * (TIMES - 1),
        torch.rand(n, generator=draw, dtype=torch.float64),
        torch.randn(n, 3, generator=draw, dtype=torch.float64),
        0.3 * torch.randn(n, 3, generator=draw, dtype=torch.float64),
    )


def rest(n: int = 5, corners: int = 4, convexes: int = 2, seed: int = 1) -> Rest:
    """Gaussians, then corners of convexes."""
    draw = torch.Generator().manual_seed(seed)
    own = life(n + convexes)
    index = torch.cat([torch.arange(n), n + torch.arange(convexes).repeat_interleave(corners)])
    points = torch.randn(len(index), 3, generator=draw, dtype=torch.float64)
    centres = points.clone()
    centres[n:] = points[n:].reshape(convexes, corners, 3).mean(1).repeat_interleave(corners, 0)
    quats = torch.randn(n, 4, generator=draw, dtype=torch.float64)
    return Rest(points, quats, points[:, :2], None, Life(*(p[index] for p in own)), centres)


def test_at_the_middle_of_its_life_a_primitive_is_at_rest_and_whole():
    given = rest()
    for k in (0, 3, 6):
        moved = FreeMotion(TIMES).carry(given, float(given.life.times[k]) / (TIMES - 1))
        assert torch.allclose(moved.points[k], given.points[k]) and float(moved.presence[k]) == pytest.approx(1.0)


def test_it_drifts_by_its_velocity_and_fades_as_a_bell():
    given = rest()
    t = 0.37
    age = t * (TIMES - 1) - given.life.times
    moved = FreeMotion(TIMES).carry(given, t)
    assert torch.allclose(moved.points[:5], (given.points + given.life.velocities * age[:, None])[:5])
    assert torch.allclose(moved.presence, torch.exp(-0.5 * (age / given.life.log_spans.exp()) ** 2))


def test_a_convex_turns_as_one_about_its_middle():
    given = rest()
    t = 0.8
    moved = FreeMotion(TIMES).carry(given, t)
    age = t * (TIMES - 1) - given.life.times
    turn = quats_to_matrices(turned_by(given.life.spins * age[:, None]))
    for k in range(5, len(given.points)):
        arm = turn[k] @ (given.points[k] - given.centres[k])
        assert torch.allclose(moved.points[k], given.centres[k] + arm + given.life.velocities[k] * age[k])


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-3, 1.0, 3.0])
def test_a_rotation_vector_turns_by_its_length(angle):
    vector = torch.tensor([[0.0, 0.0, angle]], dtype=torch.float64, requires_grad=True)
    matrix = quats_to_matrices(turned_by(vector))[0]
    expected = [[math.cos(angle), -math.sin(angle), 0], [math.sin(angle), math.cos(angle), 0], [0, 0, 1]]
    assert torch.allclose(matrix, torch.tensor(expected, dtype=torch.float64), atol=1e-12)
    matrix[1, 0].backward()
    assert vector.grad[0, 2] == pytest.approx(math.cos(angle), abs=1e-6)


def test_gradients_agree_with_central_differences():
    given = rest()

    def outputs(points, quats, *lives):
        moved = FreeMotion(TIMES).carry(Rest(points, quats, given.hyper, None, Life(*lives), given.centres), 0.42)
        return moved.points, moved.quats, moved.presence

    inputs = [p.clone().requires_grad_() for p in (given.points, given.quats, *given.life)]
    assert torch.autograd.gradcheck(outputs, inputs, eps=1e-6, atol=1e-7)


def model() -> Model:
    rng = np.random.default_rng(0)
    gaussians = GaussianSet.from_points(rng.normal(size=(20, 3)) * 0.3, rng.uniform(size=(20, 3)), 1, opacity=0.6)
    gaussians.live(torch.arange(20) / 2, 2.0, torch.from_numpy(rng.normal(size=(20, 3)) * 0.05).float())
    gaussians.dynamic[10:] = False
    convexes = ConvexSet.from_points(rng.normal(size=(4, 6, 3)) * 0.2, rng.uniform(size=(4, 3)), 1)
    convexes.live(torch.arange(4) * 3.0, 1.5)
    return Model(gaussians, convexes, FreeMotion(TIMES), 1)


def test_what_is_not_dynamic_stays_and_the_rest_comes_and_goes():
    made = model()
    before, _ = made.at(0.0, move=False)
    for t in (0.0, 0.5, 1.0):
        now, hulls = made.at(t)
        assert torch.equal(now.means[10:], before.means[10:]) and torch.equal(now.opacities[10:], before.opacities[10:])
        frame = t * (TIMES - 1)
        presence = torch.exp(-0.5 * ((frame - made.gaussians.times[:10]) / 2.0) ** 2)
        assert torch.allclose(now.opacities[:10], before.opacities[:10] * presence)
        theirs = torch.exp(-0.5 * ((frame - made.convexes.times) / 1.5) ** 2)
        assert torch.allclose(hulls.opacities, made.convexes.opacities * theirs)


def test_a_saved_model_renders_the_same():
    made = model()
    again = Model.from_arrays(made.to_arrays(), made.config)
    K = torch.tensor([[60.0, 0, 32], [0, 60.0, 24], [0, 0, 1]])
    pose = torch.eye(4)
    pose[2, 3] = 3.0
    camera = Camera(K, pose, 64, 48)
    for t in (0.1, 0.9):
        one, two = made.render(camera, t), again.render(camera, t)
        assert torch.equal(one.color, two.color) and float(one.alpha.max()) > 0.1


def test_by_default_primitives_are_there_throughout():
    gaussians = GaussianSet.from_points(np.zeros((3, 3)), np.zeros((3, 3)), 0)
    assert set(LIFE) < set(gaussians.parameters)
    moved = FreeMotion(1000).carry(Rest(gaussians.means, gaussians.quats, gaussians.hyper, None, gaussians.life), 1.0)
    assert ALWAYS > 1000 and float(moved.presence.detach().min()) > 0.99


@pytest.mark.parametrize("kind", [GaussianSet, ConvexSet])
def test_how_a_primitive_drifts_says_nothing_of_how_it_turns(kind):
    """Velocities and spins begin alike, at zero, and are still two things."""
    rng = np.random.default_rng(0)
    colors = np.zeros((4, 3))
    made = (
        kind.from_points(rng.normal(size=(4, 3)), colors, 0)
        if kind is GaussianSet
        else kind.from_points(rng.normal(size=(4, 6, 3)), colors, 0)
    )
    made.live(0.0, 1.0, torch.ones(4, 3))
    assert float(made.spins.detach().abs().max()) == 0 and float(made.velocities.detach().min()) == 1


def standing(times: int = TIMES) -> Views:
    """One camera that stands, once for each time, before a grey wall."""
    K = np.tile(np.array([[60.0, 0, 32], [0, 60.0, 24], [0, 0, 1]]), (times, 1, 1))
    pose = np.eye(4)
    pose[2, 3] = 3.0
    index = np.arange(times)
    picture = np.full((48, 64, 3), 128, np.uint8)
    return Views(
        K,
        np.tile(pose, (times, 1, 1)),
        np.linspace(0, 1, times),
        np.zeros(times, int),
        np.append(index[1:], -1),
        index,
        64,
        48,
        lambda i: picture,
    )


def test_a_short_life_is_judged_by_the_views_in_it():
    """The first lives around frame 2, the second throughout; both would look alike."""
    gaussians = GaussianSet.from_points(np.array([[-0.5, 0, 0], [0.5, 0, 0]]), np.zeros((2, 3)), 0, opacity=0.8)
    gaussians.live(torch.tensor([2.0, 5.0]), 1.0)
    with torch.no_grad():
        gaussians.log_scales.fill_(math.log(0.1))
        gaussians.log_spans[1] = math.log(ALWAYS)
    made = Model(gaussians, ConvexSet.empty(6, 0), FreeMotion(TIMES), 0)
    found = measure_responsibility(made, standing(), list(range(TIMES)), move=True)
    assert float(found.weight_gaussians[0] / found.weight_gaussians[1]) == pytest.approx(1, abs=0.15)
    assert float(found.error_gaussians[0] / found.error_gaussians[1]) == pytest.approx(1, abs=0.15)
    share = np.exp(-0.5 * (np.arange(TIMES) - 2.0) ** 2).mean()
    assert found.life_gaussians.tolist() == pytest.approx([share, 1.0], rel=1e-3)
    without = measure_responsibility(made, standing(), [8, 9, 10], move=True)
    assert torch.isinf(without.weight_gaussians[0]) and torch.isfinite(without.weight_gaussians[1])
    assert float(without.error_gaussians[0]) == 0.0
    assert survivors(made.gaussians, 0.01, without.weight_gaussians, 0.25).tolist() == [0, 1]
