"""Finding parts that turn too fast for gradients, on rendered balls whose turn is known."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from e4dgs.rasterizer import Gaussians, rasterize
from e4dgs.scene.fibonacci import fibonacci_sphere
from e4dgs.scene.model import Model
from e4dgs.scene.motion.nodes import turning
from e4dgs.scene.motion.nodes.control_nodes import ControlNodes
from e4dgs.scene.motion.nodes.steady_turn import DIRECTIONS, FEW_DIRECTIONS, MIN_FRAMES, TurnSearch, compact_parts, rotation_vectors
from e4dgs.scene.motion.nodes.turning import FRESH, WIDER
from e4dgs.scene.primitives import ConvexSet, GaussianSet
from e4dgs.scene.views import Views
from pretend_cuda import pretending_cuda
from scipy.spatial.transform import Rotation
from simt import needs_compiler

SIZE, RADIUS = 64, 0.3
OMEGA = np.radians([4.0, 9.0, -5.0])  # a frame: 11 degrees, two fifths of a spot


def path(frames):
    t = np.linspace(0, 1, frames)
    return np.stack([0.5 + 0.1 * t, 0.2 * np.sin(3 * t), -0.1 * t], 1)


def turning_ball(frames, omega, plain=False):
    """Views of a spotted ball, each from another side, on white."""
    rng = np.random.default_rng(2)
    centre, directions = path(frames), fibonacci_sphere(250)
    spots = fibonacci_sphere(14)
    colors = np.full((250, 3), 0.5) if plain else rng.uniform(size=(14, 3))[(directions @ spots.T).argmax(1)]
    eyes = rng.normal(size=(frames, 3))
    eyes[:, 2] = 0.3 + np.abs(eyes[:, 2])
    poses, images = [], []
    for k, eye in enumerate(4 * eyes / np.linalg.norm(eyes, axis=1, keepdims=True)):
        forward = -eye / np.linalg.norm(eye)
        right = np.cross(forward, [0, 0, 1.0])
        right /= np.linalg.norm(right)
        R = np.stack([right, np.cross(forward, right), forward])
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = R, -R @ eye
        poses.append(pose)
        points = centre[k] + RADIUS * 0.68 * Rotation.from_rotvec(omega * k).apply(directions)
        quats = torch.tensor([1.0, 0, 0, 0]).repeat(250, 1)
        images.append((points, quats, colors))
    K = np.array([[90.0, 0, SIZE / 2], [0, 90, SIZE / 2], [0, 0, 1]])
    views = Views(
        np.repeat(K[None], frames, 0), np.array(poses), np.linspace(0, 1, frames), np.arange(frames), np.full(frames, -1),
        np.arange(frames), SIZE, SIZE, lambda i: rendered[i], (1.0, 1.0, 1.0),
    )  # fmt: skip
    rendered = []
    for i, (points, quats, colors) in enumerate(images):
        ball = Gaussians(
            torch.tensor(points).float(), quats, torch.full((250, 3), 0.03), torch.full((250,), 0.95), colors=torch.tensor(colors).float()
        )
        color = rasterize(views.rasterizer_camera(i), ball, None, torch.ones(3)).color
        rendered.append((color.clamp(0, 1) * 255).round().to(torch.uint8).numpy())
    return views


def search(views, shift=(0.0, 0.0, 0.0)):
    frames = np.arange(len(views.train))
    return TurnSearch(views, frames, path(len(frames)) + np.array(shift), RADIUS)


def test_a_steady_turn_is_found_and_so_is_its_centre():
    shift = np.array([0.0, 0.03, 0.06])
    spin = search(turning_ball(40, OMEGA), shift).find()
    assert spin is not None and spin.gain < 0.6
    # The sphere is no exact model even of this ball; what is left here is what training refines.
    assert np.degrees(np.linalg.norm(spin.omega - OMEGA)) < 1.5
    assert np.linalg.norm(spin.offset + shift) < 0.15 * RADIUS


@needs_compiler
def test_a_search_on_a_gpu_finds_the_same():
    views = turning_ball(30, OMEGA)
    want = search(views).find()
    with pretending_cuda():
        got = search(replace(views, device="cuda")).find()
    assert np.allclose(got.omega, want.omega, atol=1e-3) and np.allclose(got.offset, want.offset, atol=1e-3)


@pytest.mark.parametrize("views", [turning_ball(30, 0 * OMEGA), turning_ball(30, OMEGA, plain=True)], ids=["still", "plain"])
def test_what_does_not_turn_and_what_shows_no_turn_is_left_alone(views):
    assert search(views).find() is None


def test_without_a_promising_candidate_the_search_ends_early(monkeypatch):
    still = search(turning_ball(30, 0 * OMEGA))
    monkeypatch.setattr(still, "_descend", lambda *args: pytest.fail("nothing to refine"))
    assert still.find() is None
    candidate = torch.tensor(OMEGA).float()[None]
    few, many = (search(turning_ball(40, OMEGA)).over_windows(candidate, torch.zeros(3), 6, n) for n in (FEW_DIRECTIONS, DIRECTIONS))
    assert float(few) == pytest.approx(float(many), rel=0.05)


def test_a_capture_of_few_frames_is_left_alone():
    assert search(turning_ball(MIN_FRAMES - 1, OMEGA)).find() is None


def test_the_variance_is_lowest_at_the_true_turn_and_its_gradient_agrees_with_central_differences():
    s = search(turning_ball(24, OMEGA))
    true = torch.tensor(OMEGA).float()[None]
    around = torch.cat([true, true + np.radians(4) * torch.cat([torch.eye(3), -torch.eye(3)])])
    assert int(s.over_windows(around, torch.zeros(3), 6).argmin()) == 0
    omega = (true + 0.05).requires_grad_()
    s.over_windows(omega, torch.zeros(3), 6).sum().backward()
    step = torch.zeros(3)
    step[1] = 2e-3
    with torch.no_grad():
        plus, minus = (s.over_windows(omega + sign * step, torch.zeros(3), 6) for sign in (1, -1))
    assert float((plus - minus) / 4e-3) == pytest.approx(float(omega.grad[0, 1]), rel=0.05)


def test_frames_that_a_window_lacks_and_turns_beside_a_turn_change_nothing():
    s = search(turning_ball(24, OMEGA))
    omega = torch.tensor(OMEGA).float() + 0.05 * torch.arange(9.0).view(3, 3)
    offset = 0.1 * torch.eye(3)
    short, padded = torch.arange(5, 12)[None], torch.cat([torch.arange(5, 12), torch.tensor([-1, -1])])[None]
    with torch.no_grad():
        alone = torch.cat([s.variance(omega[i : i + 1], offset[i : i + 1], short) for i in range(3)])
        assert torch.allclose(s.variance(omega, offset, padded), alone, rtol=1e-4)
        both = s.variance(omega, offset, torch.cat([padded, torch.arange(9)[None]]))
        assert torch.allclose(both, torch.cat([alone, s.variance(omega, offset, torch.arange(9)[None])], 1), rtol=1e-4)


def test_rotation_vectors_agree_with_scipy_and_are_smooth_at_zero():
    v = np.random.default_rng(0).normal(size=(20, 3))
    assert np.allclose(rotation_vectors(torch.tensor(v)).numpy(), Rotation.from_rotvec(v).as_matrix(), atol=1e-6)
    zero = torch.zeros(1, 3, requires_grad=True)
    rotation_vectors(zero).sum().backward()
    assert torch.isfinite(zero.grad).all()


def test_parts_are_compact_clusters_of_error():
    rng = np.random.default_rng(0)
    body, ball = rng.uniform(-1, 1, (600, 3)), np.array([3.0, 0, 0]) + 0.3 * fibonacci_sphere(100)
    means = np.concatenate([body, ball])
    error = np.concatenate([rng.uniform(0.5, 1.5, 600), np.full(100, 8.0)])
    (part,) = compact_parts(means, error)
    assert np.allclose(part.centre, [3, 0, 0], atol=0.02) and part.radius == pytest.approx(0.3, abs=0.02)
    assert part.share == pytest.approx(800 / error.sum(), abs=0.03)
    assert compact_parts(means, np.ones(700)) == [] and compact_parts(means[:10], error[-10:]) == []
    assert compact_parts(means, np.zeros(700)) == []


def test_a_turning_part_becomes_a_rigid_part_with_fresh_gaussians(monkeypatch):
    views = turning_ball(40, OMEGA)
    rng = np.random.default_rng(1)
    rest = path(40)[20]
    cloud = np.concatenate([rest + RADIUS * fibonacci_sphere(80), rng.uniform(-1, 0, (300, 3))])
    gaussians = GaussianSet.from_points(cloud, np.full((380, 3), 0.5), 0)
    nodes = ControlNodes(torch.tensor(rng.uniform(-1, 0, (10, 3))), torch.zeros(3), 1.0, 1.0)
    monkeypatch.setattr(turning, "part_path", lambda nodes, scene, part, times: path(40))  # as trained nodes would carry it
    model = Model(gaussians, ConvexSet.empty(6, 0), nodes, 0)
    error = torch.tensor(np.concatenate([np.full(80, 9.0), np.ones(300)])).float()
    said = []
    model.motion, model.gaussians, source = model.motion.with_turning_parts(model, views, error, 0, said.append)
    assert len(model.gaussians) == len(source) == 300 + FRESH and (source[-FRESH:] == -1).all()
    assert torch.equal(source[:300], torch.arange(80, 380)) and "turns by 11" in said[0]
    rigid_parts = model.motion.rigid_parts
    assert len(rigid_parts) == 1 and float(rigid_parts.radius[0]) == pytest.approx(WIDER * RADIUS, rel=0.1)
    a, b = (rigid_parts.pose(k / 39)[0][0].detach() for k in (20, 22))
    turned = np.degrees((Rotation.from_quat(b[[1, 2, 3, 0]]) * Rotation.from_quat(a[[1, 2, 3, 0]]).inv()).as_rotvec())
    assert np.allclose(turned, 2 * np.degrees(OMEGA), atol=3.0)
    there = rigid_parts.home[0] + rigid_parts.pose(10 / 39)[1][0].detach()
    assert np.linalg.norm(there.numpy() - path(40)[10]) < 0.05
    again = model.motion.with_turning_parts(model, views, torch.cat([torch.zeros(300), torch.full((FRESH,), 9.0)]), 0, said.append)
    assert again is None and len(said) == 1  # a rigid part is left alone
    # What is fresh goes with the new rigid part alone, and nothing else does.
    link = model.links(model.gaussians)
    assert (link[-FRESH:, 0] == 10).all() and not (link[:-FRESH, 0] == 10).any()
