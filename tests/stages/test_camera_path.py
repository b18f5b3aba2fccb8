"""Paths of cameras through a scene."""

from types import SimpleNamespace

import numpy as np
import pytest
from e4dgs.scene.camera_paths import centres
from e4dgs.scene.model import Model
from e4dgs.scene.motion.static import Static
from e4dgs.scene.primitives import ConvexSet, GaussianSet
from e4dgs.stages.exports.camera_path import followed, named_path, seconds_of


def ring(cameras: int = 6, radius: float = 3.0) -> SimpleNamespace:
    """Cameras on a circle that look at its middle, (0, 0, 5)."""
    poses = np.tile(np.eye(4), (cameras, 1, 1))
    for pose, angle in zip(poses, np.linspace(0, 2 * np.pi, cameras, endpoint=False)):
        forward = np.array([np.cos(angle), 0.0, np.sin(angle)])
        pose[:3, :3] = np.stack([np.cross([0.0, 1.0, 0.0], forward), [0.0, 1.0, 0.0], forward])
        pose[:3, 3] = -pose[:3, :3] @ (np.array([0.0, 0.0, 5.0]) - radius * forward)
    index = np.arange(cameras)
    K = np.tile([[20.0, 0, 8], [0, 20.0, 8], [0, 0, 1]], (cameras, 1, 1))
    time = np.linspace(0, 1, cameras)
    frames = SimpleNamespace(
        cam_from_world=poses, K=K, train=index, camera=index, time=time, seconds=3 * time, width=16, height=16, origin=None
    )
    frames.held = lambda i: frames.cam_from_world[i]
    return frames


def nothing() -> Model:
    """A model without primitives."""
    return Model(GaussianSet.from_points(np.zeros((0, 3)), np.zeros((0, 3)), 0), ConvexSet.empty(6, 0), Static(), 0)


def walk(pictures: int = 30, times: np.ndarray | None = None) -> SimpleNamespace:
    """One camera on a third of that circle."""
    frames = ring(3 * pictures)
    for name in ("cam_from_world", "K", "train", "time", "seconds"):
        setattr(frames, name, getattr(frames, name)[:pictures])
    frames.time = np.linspace(0, 1, pictures) if times is None else times
    frames.seconds, frames.camera = 3 * frames.time, np.zeros(pictures, int)
    return frames


def rig(times: int = 4) -> SimpleNamespace:
    """Six cameras on the circle that stand still, at each of several times."""
    frames = ring()
    frames.camera = np.repeat(frames.camera, times)
    frames.time = np.tile(np.linspace(0, 1, times), 6)
    frames.seconds, frames.train = 3 * frames.time, np.arange(6 * times)
    frames.cam_from_world, frames.K = (np.repeat(values, times, axis=0) for values in (frames.cam_from_world, frames.K))
    return frames


CENTRE = np.array([0.0, 0.0, 5.0])


@pytest.fixture
def centred(monkeypatch):
    """What the cameras look at is the middle of the circle; an empty model cannot say so."""
    monkeypatch.setattr("e4dgs.stages.exports.camera_path.looked_at", lambda frames, model: CENTRE)


@pytest.mark.parametrize("frames", [ring(), rig()], ids=["a new camera at every time", "a rig"])
def test_separate_cameras_are_visited_without_coming_nearer_than_they_are(frames, centred):
    """A straight way between opposite cameras would lead through the subject."""
    assert followed(frames) is None
    path = named_path("capture", frames, nothing(), 61, seconds=30.0)
    distances = np.linalg.norm(centres(path.cam_from_world) - CENTRE, axis=1)
    np.testing.assert_allclose(distances, 3.0, atol=1e-9)
    for pose in ring().cam_from_world:
        assert np.abs(path.cam_from_world - pose).max((1, 2)).min() < 1e-6, "every camera is passed"
    np.testing.assert_allclose(path.time, np.linspace(0, 1, 61))


def test_a_short_tour_has_few_stops(centred):
    """Two a second: all of forty cameras in a second could not be looked at."""
    frames = ring(40)
    frames.cam_from_world = np.random.default_rng(0).permutation(frames.cam_from_world)
    path = named_path("capture", frames, nothing(), 31, seconds=1.0)
    assert np.linalg.norm(np.diff(centres(path.cam_from_world), axis=0), axis=1).sum() < 3 * np.pi + 1e-6


def test_a_moving_camera_is_followed_in_real_time():
    """Its pictures at uneven times: at each moment of the film it is where it was."""
    times = np.sort(np.random.default_rng(0).uniform(0.2, 0.8, 30))
    frames = walk(times=times)
    assert followed(frames).tolist() == list(range(30))
    assert seconds_of("capture", frames, moves=False) == pytest.approx(3 * np.ptp(times))
    path = named_path("capture", frames, nothing(), 200)
    np.testing.assert_allclose(path.time, np.linspace(times[0], times[-1], 200))
    known = centres(frames.cam_from_world).T
    np.testing.assert_allclose(centres(path.cam_from_world).T, [np.interp(path.time, times, line) for line in known], atol=1e-9)


def test_a_moving_camera_with_a_gap_goes_around_what_it_looks_at(centred):
    frames = walk()
    keep = np.array([*range(3), *range(27, 30)])
    for name in ("cam_from_world", "K", "time", "seconds", "camera"):
        setattr(frames, name, getattr(frames, name)[keep])
    frames.train = np.arange(6)
    path = named_path("capture", frames, nothing(), 50)
    assert followed(frames) is not None
    np.testing.assert_allclose(np.linalg.norm(centres(path.cam_from_world) - CENTRE, axis=1), 3.0, rtol=2e-3)


def test_the_moving_one_of_several_cameras_is_followed():
    frames, still = walk(), rig(40)
    moving = {name: getattr(frames, name) for name in ("cam_from_world", "K", "time", "seconds")}
    for name, values in moving.items():
        setattr(frames, name, np.concatenate([getattr(still, name)[:40], values]))
    frames.camera, frames.train = np.repeat([5, 7], [40, 30]), np.arange(70)
    assert followed(frames).tolist() == list(range(40, 70))


def test_one_camera_that_stands_still_stays_so():
    frames = rig()
    frames.train = np.arange(4)
    path = named_path("capture", frames, nothing(), 5)
    assert np.ptp(path.cam_from_world, axis=0).max() == 0 and path.time.tolist() == [0, 0.25, 0.5, 0.75, 1]


def test_the_lens_follows_that_of_the_camera():
    frames = walk()
    frames.K[:, 0, 0] = np.linspace(20, 40, 30)
    np.testing.assert_allclose(named_path("capture", frames, nothing(), 3).K[:, 0, 0], [20, 30, 40])


@pytest.mark.parametrize(
    ("name", "frames", "moves", "seconds"),
    [("turntable", ring(), True, 3.0), ("turntable", ring(), False, None), ("capture", rig(), True, 3.0), ("capture", rig(), False, None)],
)
def test_a_film_in_real_time_takes_as_long_as_the_capture(name, frames, moves, seconds):
    assert seconds_of(name, frames, moves) == seconds


@pytest.mark.parametrize("name", ["turntable", "spiral", "capture"])
def test_a_model_without_gaussians_can_be_walked_around_too(name):
    path = named_path(name, ring(), nothing(), 4)
    assert path.cam_from_world.shape == (4, 4, 4) and np.isfinite(path.cam_from_world).all()
