"""Cameras that turn and hardly move: solved from matches alone, refused where the camera moves, said in words where nothing tells."""

from dataclasses import replace

import numpy as np
import pytest
from e4dgs.vision.sfm.alignment import similarity
from e4dgs.vision.sfm.trouble import nothing_registered
from e4dgs.vision.sfm.turning import bundle as bundle_module
from e4dgs.vision.sfm.turning.bundle import GROUP, Bundle, _jacobians, _normal, _step, _tangents, rotations
from e4dgs.vision.sfm.turning.solve import ANYHOW, UNTOLD, solve_turning
from e4dgs.vision.sfm.turning.tracks import join

WIDTH, HEIGHT, FRAMES, NOISE = 640, 360, 12, 0.1


def pan(focal: float, motion: float, degrees: float = 1.0, points: int = 400):
    """Matches and places of a camera that pans by so many degrees a frame and goes sideways by `motion` of the nearest distance in all; its
    rotations, centres, and the true points (distances 1 to 3)."""
    rng = np.random.default_rng(5)
    angles = np.radians(degrees) * (np.arange(FRAMES) - FRAMES / 2)
    R = rotations(np.column_stack([0.2 * angles, angles, 0 * angles]))
    centres = motion * np.column_stack([np.linspace(-0.5, 0.5, FRAMES), 0.2 * np.sin(np.arange(FRAMES)), np.zeros(FRAMES)])
    half = np.array([WIDTH, HEIGHT]) / 2 / focal + np.radians(degrees) * FRAMES / 2
    depth = rng.uniform(1, 3, points)
    world = np.column_stack([rng.uniform(-1, 1, (points, 2)) * half, np.ones(points)]) * depth[:, None]
    places, which = [], []
    for i in range(FRAMES):
        local = (world - centres[i]) @ R[i].T
        xy = focal * local[:, :2] / local[:, 2:] + [WIDTH / 2, HEIGHT / 2] + rng.normal(0, NOISE, (points, 2))
        inside = np.flatnonzero((local[:, 2] > 0) & (xy >= 0).all(1) & (xy < [WIDTH, HEIGHT]).all(1))
        places.append(xy[inside])
        which.append(inside)
    matches = {}
    for a in range(FRAMES):
        for b in range(a + 1, FRAMES):
            _, first, second = np.intersect1d(which[a], which[b], return_indices=True)
            if len(first) >= 15:
                matches[a, b] = np.column_stack([first, second])
    return matches, places, R, centres


def turn_errors(found: np.ndarray, true: np.ndarray) -> np.ndarray:
    """[F - 1] degrees: of the rotations from the first frame."""
    relative = np.einsum("fij,kj->fik", found[1:], found[0])
    wanted = np.einsum("fij,kj->fik", true[1:], true[0])
    cosine = (np.einsum("fij,fij->f", relative, wanted) - 1) / 2
    return np.degrees(np.arccos(np.clip(cosine, -1, 1)))


def test_a_pan_that_moves_a_little_gives_lens_rotations_and_the_path():
    matches, places, R, centres = pan(focal=1500.0, motion=0.02)
    assert solve_turning(matches, places, WIDTH, HEIGHT) is None, "the mapper tries first"
    found = solve_turning(matches, places, WIDTH, HEIGHT, fits=ANYHOW)
    assert found.frames.all() and found.moved
    assert found.bundle.focal == pytest.approx(1500, rel=0.05)
    assert np.median(found.bundle.errors()) < 2 * NOISE and turn_errors(found.bundle.R, R).max() < 0.5
    mine = -np.einsum("fji,fj->fi", found.bundle.R, found.bundle.t)
    scale, turn, t = similarity(mine[:, [0, 1, 2]], centres)
    assert np.linalg.norm(scale * mine @ turn.T + t - centres, axis=1).max() < 0.1 * 0.02


def test_a_camera_that_only_turns_is_solved_and_told_to_tell_no_distances():
    matches, places, R, _ = pan(focal=800.0, motion=0.0)
    found = solve_turning(matches, places, WIDTH, HEIGHT)
    assert found.frames.all() and not found.moved and not found.bundle.t.any() and (found.bundle.rho == 1).all()
    assert found.bundle.focal == pytest.approx(800, rel=0.03)
    assert turn_errors(found.bundle.R, R).max() < 0.2


def test_a_camera_that_moves_is_left_to_the_mapper():
    matches, places, _, _ = pan(focal=800.0, motion=0.6)
    assert solve_turning(matches, places, WIDTH, HEIGHT) is None
    assert solve_turning(matches, places, WIDTH, HEIGHT, fits=ANYHOW) is None
    assert solve_turning({}, [np.zeros((0, 2))] * 3, WIDTH, HEIGHT) is None


def test_frames_without_matches_are_left_out():
    matches, places, _, _ = pan(focal=800.0, motion=0.0)
    alone = {pair: m for pair, m in matches.items() if 3 not in pair}
    found = solve_turning(alone, places, WIDTH, HEIGHT)
    assert np.flatnonzero(~found.frames).tolist() == [3]


def test_a_turn_too_small_to_tell_the_lens_takes_the_usual_one():
    matches, places, _, _ = pan(focal=800.0, motion=0.0, degrees=0.01)
    found = solve_turning(matches, places, WIDTH, HEIGHT)
    assert found.bundle.focal == UNTOLD * WIDTH
    assert solve_turning(matches, places, WIDTH, HEIGHT, focal=800.0).bundle.focal == pytest.approx(800, rel=0.5)


def small_bundle() -> Bundle:
    """9 frames, each of which sees half of more points than one group has."""
    rng = np.random.default_rng(1)
    frames, points = 9, GROUP + 20
    seen = rng.random((points, frames)) < 0.5
    seen[:, :2] = True
    point, frame = np.nonzero(seen)
    d = rng.normal((0, 0, 1), 0.2, (points, 3))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    R, t = rotations(rng.normal(0, 0.05, (frames, 3))), rng.normal(0, 0.02, (frames, 3))
    bundle = Bundle(R, t, d, rng.uniform(0.3, 1, points), 500.0, 0.1, np.array([320.0, 180.0]), frame, point, np.zeros((len(point), 2)))
    local = bundle.local()
    return replace(bundle, xy=500 * local[:, :2] / local[:, 2:] + [320, 180] + rng.normal(0, 2, (len(point), 2)))


@pytest.mark.parametrize(("move", "lens"), [(False, 0), (False, 2), (True, 0), (True, 2)])
def test_a_step_is_that_of_all_unknowns_solved_at_once(move, lens):
    bundle, damping = small_bundle(), 1e-2
    residual, to_camera, to_point, to_lens = _jacobians(bundle, move, lens)
    frames, points, per, k = len(bundle.R), len(bundle.d), to_camera.shape[2], to_point.shape[2]
    J = np.zeros((len(residual), 2, per * frames + lens + k * points))
    for o, (f, p) in enumerate(zip(bundle.frame, bundle.point, strict=True)):
        J[o, :, per * f : per * (f + 1)] = to_camera[o]
        J[o, :, per * frames : per * frames + lens] = to_lens[o]
        J[o, :, per * frames + lens + k * p : per * frames + lens + k * (p + 1)] = to_point[o]
    weight = 1 / (1 + (residual**2).sum(1) / 4.0)
    N, g = np.einsum("o,oia,oib->ab", weight, J, J), np.einsum("o,oia,oi->a", weight, J, residual)
    x = -np.linalg.solve(N + damping * np.diag(np.diag(N)) + 1e-9 * np.eye(len(N)), g)
    stepped = _step(bundle, _normal(bundle, 2.0, move, lens), damping, move, lens)
    turns = x[: per * frames].reshape(frames, per)[:, :3]
    assert np.abs(stepped.R - rotations(turns) @ bundle.R).max() < 1e-6
    if move:
        assert np.abs(stepped.rho - bundle.rho - x[per * frames + lens :].reshape(points, k)[:, 2]).max() < 1e-4
    assert np.median(stepped.errors()) < np.median(bundle.errors())


def test_a_step_does_not_depend_on_the_number_of_threads(monkeypatch):
    bundle, found = small_bundle(), []
    monkeypatch.setattr(bundle_module, "GROUP", 5)
    for threads in (1, 4):
        monkeypatch.setattr(bundle_module, "thread_count", lambda threads=threads: threads)
        found.append(_step(bundle, _normal(bundle, 1.0, True, 2), 1e-3, True, 2))
    one, several = found
    assert np.array_equal(one.R, several.R) and np.array_equal(one.d, several.d) and one.k1 == several.k1


def test_derivatives_are_those_of_central_differences():
    bundle, h = small_bundle(), 1e-6
    _, to_camera, to_point, to_lens = _jacobians(bundle, True, 2)

    def slope(change) -> np.ndarray:
        """[O, 2] of the residuals. change: the bundle after a step of so much."""
        return (_jacobians(change(h), True, 2)[0] - _jacobians(change(-h), True, 2)[0]) / (2 * h)

    def turned(axis: np.ndarray, by: float) -> Bundle:  # of the direction alone, as the unknowns are: t stays
        return replace(bundle, R=rotations(by * axis[None]) @ bundle.R)

    def aside(k: int, by: float) -> Bundle:
        return replace(bundle, d=bundle.d + by * _tangents(bundle.d)[:, :, k])

    for k, axis in enumerate(np.eye(3)):
        assert np.abs(slope(lambda by, axis=axis: turned(axis, by)) - to_camera[:, :, k]).max() < 1e-4
        assert np.abs(slope(lambda by, axis=axis: replace(bundle, t=bundle.t + by * axis)) - to_camera[:, :, 3 + k]).max() < 1e-4
    for k in range(2):
        assert np.abs(slope(lambda by, k=k: aside(k, by)) - to_point[:, :, k]).max() < 1e-4
    assert np.abs(slope(lambda by: replace(bundle, rho=bundle.rho + by)) - to_point[:, :, 2]).max() < 1e-4
    assert np.abs(slope(lambda by: replace(bundle, focal=bundle.focal * np.exp(by))) - to_lens[:, :, 0]).max() < 1e-4
    assert np.abs(slope(lambda by: replace(bundle, k1=bundle.k1 + by)) - to_lens[:, :, 1]).max() < 1e-4


def test_tracks_join_matches_and_leave_out_mistakes():
    places = [np.full((3, 2), float(i)) for i in range(4)]
    same = np.array([[0, 0], [1, 1]])
    matches = {(0, 1): same, (1, 2): same, (2, 3): np.array([[0, 0]]), (0, 2): np.array([[2, 1]])}
    tracks = join(matches, places, 10)
    assert tracks.count == 1, "the second would hold two features of image 0"
    assert tracks.frame.tolist() == [0, 1, 2, 3] and tracks.xy[:, 0].tolist() == [0, 1, 2, 3]
    assert join({(0, 1): same}, places, 10).count == 0, "two images are not enough"


@pytest.mark.parametrize(
    ("features", "pairs", "cause"),
    [
        (50, {"matched": [0] * 4, "shift": 0.0, "flat": 0.0}, "dark, blurred or plain"),
        (900, {"matched": [0, 0, 0, 40], "shift": 0.1, "flat": 0.0}, "3 frames have no other frame"),
        (900, {"matched": [400] * 4, "shift": 0.001, "flat": 1.0}, "the camera hardly moves"),
        (900, {"matched": [400] * 4, "shift": 0.1, "flat": 0.95}, "only turns or zooms"),
        (900, {"matched": [400] * 4, "shift": 0.1, "flat": 0.1}, "enough of the same static things"),
    ],
)
def test_the_reason_for_no_cameras_is_named(features, pairs, cause):
    message = nothing_registered(4, [features] * 4, pairs, "exhaustive")
    assert cause in message and ("provide poses" in message or "--set poses." in message)
