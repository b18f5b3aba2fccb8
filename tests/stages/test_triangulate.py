"""Points from known cameras against the surfaces of a rendered room; matching along epipolar lines against exact pairs."""

from types import SimpleNamespace

import numpy as np
import pytest
from e4dgs.pipeline import StageError
from e4dgs.vision.sfm.alignment import camera_centres
from e4dgs.vision.sfm.epipolar import fundamental, guided_matches
from e4dgs.vision.triangulate import choose_frames, choose_pairs, keep_precise, thrice, triangulate
from factory import Options, make, render, to_uint8


def fake_frameset(**options) -> tuple[SimpleNamespace, list]:
    """The fields of `FrameSet` that triangulation reads, and the truth of every frame. The last camera's frames are black."""
    synthetic = make(Options(backdrop="room", width=200, height=150, samples=2, fov_degrees=60.0, **options))
    truths = [render(synthetic.scene, view.camera, view.time) for view in synthetic.views]
    pictures = [to_uint8(truth.image)[..., :3] for truth in truths]
    frames = SimpleNamespace(
        K=np.stack([view.camera.K for view in synthetic.views]),
        cam_from_world=np.stack([view.camera.cam_from_world for view in synthetic.views]),
        time=np.array([view.time for view in synthetic.views]),
        camera=np.array([view.camera_index for view in synthetic.views]),
        train=np.arange(len(synthetic.views)),
        width=200,
        height=150,
        composited=lambda i: pictures[i],
    )
    return frames, truths


def depth_errors(points: np.ndarray, frames: SimpleNamespace, truths: list) -> np.ndarray:
    """[P] smallest relative difference to the true depth over all frames that show the point."""
    best = np.full(len(points), np.inf)
    for K, pose, truth in zip(frames.K, frames.cam_from_world, truths):
        local = points @ pose[:3, :3].T + pose[:3, 3]
        uv = np.floor((local @ K.T)[:, :2] / local[:, 2:]).astype(int)
        seen = np.flatnonzero((local[:, 2] > 0) & (uv >= 0).all(1) & (uv[:, 0] < frames.width) & (uv[:, 1] < frames.height))
        true = truth.depth[uv[seen, 1], uv[seen, 0]]
        best[seen] = np.minimum(best[seen], np.abs(local[seen, 2] - true) / np.maximum(true, 1e-9))
    return best


@pytest.fixture(scope="module")
def rig():
    """5 fixed cameras x 3 times with moving things; camera 0 looks at nothing (a covered lens)."""
    frames, truths = fake_frameset(rig="arc", cameras=5, times=3)
    picture = frames.composited
    frames.composited = lambda i: np.zeros((150, 200, 3), np.uint8) if frames.camera[i] == 0 else picture(i)
    return frames, truths


def test_a_rig_gives_points_on_the_surfaces(rig):
    frames, truths = rig
    points, colors, errors = triangulate(frames)
    assert len(points) >= 100 and points.dtype == np.float64 and colors.dtype == np.uint8
    assert colors.shape == points.shape and errors.shape == (len(points),)
    assert 0 < errors.max() <= 2.0
    wrong = depth_errors(points, frames, truths)
    assert np.median(wrong) < 0.01 and (wrong > 0.05).mean() < 0.05


def test_two_cameras_must_do_where_there_is_no_third():
    frames, truths = fake_frameset(rig="arc", cameras=2, times=3)
    points, _, errors = triangulate(frames)
    assert len(points) >= 50 and errors.max() <= 2.0
    wrong = depth_errors(points, frames, truths)
    assert np.median(wrong) < 0.02 and (wrong > 0.05).mean() < 0.15


def test_three_frames_are_matched_where_one_is_in_two_pairs():
    assert not thrice([(0, 1)]) and not thrice([(0, 1), (2, 3)])
    assert thrice([(0, 1), (1, 2)]) and thrice([(0, 1), (2, 3), (2, 4)])


def test_colours_are_those_of_the_pictures(rig):
    frames, _ = rig
    points, colors, _ = triangulate(frames)
    local = points @ frames.cam_from_world[3][:3, :3].T + frames.cam_from_world[3][:3, 3]
    uv = np.floor((local @ frames.K[3].T)[:, :2] / local[:, 2:]).astype(int)
    inside = (uv >= 0).all(1) & (uv[:, 0] < 200) & (uv[:, 1] < 150)
    found = frames.composited(3)[uv[inside, 1], uv[inside, 0]].astype(int)
    assert np.median(np.abs(found - colors[inside])) < 16


def test_one_moving_camera_gives_the_same_points_twice():
    frames, truths = fake_frameset(rig="path", times=12, motion=0.0)
    first, second = triangulate(frames), triangulate(frames)
    for a, b in zip(first, second):
        assert np.array_equal(a, b)
    wrong = depth_errors(first[0], frames, truths)
    assert len(wrong) >= 100 and np.median(wrong) < 0.02


def test_the_last_adjustment_has_one_thread():
    """COLMAP takes several from 50,000 residuals on, more than a test should have; sums in another order then differ in their last bits."""
    known_poses = pytest.importorskip("e4dgs.vision.sfm.worker.known_poses")
    options = known_poses._options({"seed": 0, "max_error": 2.0, "min_angle": 1.0, "min_track": 2})
    assert options.num_threads == options.mapper.num_threads == 1


def test_views_without_anything_in_common_give_no_points(rig):
    frames, _ = rig
    alone = SimpleNamespace(**{**vars(frames), "train": np.array([1])})
    assert [len(part) for part in triangulate(alone)] == [0, 0, 0]
    dark = SimpleNamespace(**{**vars(frames), "composited": lambda i: np.zeros((150, 200, 3), np.uint8)})
    assert [len(part) for part in triangulate(dark)] == [0, 0, 0]


def test_frames_without_poses_are_refused(rig):
    with pytest.raises(StageError, match="needs poses"):
        triangulate(SimpleNamespace(**{**vars(rig[0]), "K": None}))


def test_times_of_a_rig_are_first_middle_last_and_never_mixed(rig):
    frames, _ = rig
    time = np.repeat(np.linspace(0, 1, 9), 4)
    chosen = choose_frames(np.arange(36), time, max_frames=90)
    assert sorted(set(time[chosen])) == [0.0, 0.5, 1.0] and len(chosen) == 12
    assert len(choose_frames(np.arange(36), time, max_frames=4)) == 4
    assert choose_frames(np.arange(30), np.arange(30.0), max_frames=4).tolist() == [0, 10, 19, 29]
    pairs = choose_pairs(frames.cam_from_world, frames.time)
    assert pairs and all(frames.time[a] == frames.time[b] and a < b for a, b in pairs)


def test_a_camera_that_stands_still_has_no_pairs():
    pose = np.tile(np.eye(4), (6, 1, 1))
    assert choose_pairs(pose, np.linspace(0, 1, 6)) == []


def test_points_far_above_the_median_error_are_dropped():
    assert keep_precise(np.array([0.3, 0.4, 0.4, 0.5, 0.9])).tolist() == [True, True, True, True, False]
    assert keep_precise(np.zeros(0)).shape == (0,)


def unit(rows: np.ndarray) -> np.ndarray:
    return (rows / np.linalg.norm(rows, axis=1, keepdims=True)).astype(np.float32)


def test_guided_matches_find_every_true_pair_and_refuse_what_lies_off_the_line():
    rng = np.random.default_rng(3)
    n = 400
    K = np.array([[300.0, 0, 160], [0, 300, 120], [0, 0, 1]])
    first, second = np.eye(4), np.eye(4)
    second[:3, 3] = -0.5, 0.1, 0.05
    world = np.column_stack([rng.uniform(-1, 1, n), rng.uniform(-1, 1, n), rng.uniform(3, 6, n)])
    project = lambda pose: ((world + pose[:3, 3]) @ K.T)[:, :2] / (world + pose[:3, 3])[:, 2:]  # noqa: E731
    xy1, xy2 = project(first), project(second)
    order = rng.permutation(n)
    descriptors = unit(rng.random((n, 128)) ** 4)
    F = fundamental(K, K, first, second)
    assert np.abs(np.einsum("ni,ij,nj->n", np.column_stack([xy2, np.ones(n)]), F, np.column_stack([xy1, np.ones(n)]))).max() < 1e-9

    matches = guided_matches(xy1, descriptors, xy2[order], descriptors[order], F)
    assert len(matches) == n and (order[matches[:, 1]] == matches[:, 0]).all()
    off = xy2.copy()
    off[:100, 1] += 50.0
    matches = guided_matches(xy1, descriptors, off[order], descriptors[order], F)
    assert not np.isin(matches[:, 0], np.arange(100)).any() and len(matches) == n - 100


def test_guided_matches_leave_out_what_could_be_either_of_two():
    F = np.array([[0.0, 0, 0], [0, 0, -1], [0, 1, 0]])  # the second camera stands to the right: lines are rows
    a = unit(np.random.default_rng(4).random((1, 128)))
    xy = np.array([[50.0, 20.0]])
    twins = np.array([[30.0, 20.0], [40.0, 20.0]])
    assert len(guided_matches(xy, a, twins, np.repeat(a, 2, axis=0), F)) == 0
    near = np.array([[30.0, 20.0], [31.0, 20.0]])  # the same corner at two scales
    assert guided_matches(xy, a, near, np.repeat(a, 2, axis=0), F).tolist() == [[0, 0]]
    assert guided_matches(np.zeros((0, 2)), a[:0], xy, a, F).shape == (0, 2)
    assert guided_matches(xy, a, np.zeros((0, 2)), a[:0], F).shape == (0, 2)


def test_camera_centres_undo_the_pose():
    pose = np.eye(4)
    pose[:3, :3] = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]
    pose[:3, 3] = 1, 2, 3
    centre = camera_centres(pose[None])[0]
    assert np.allclose(pose[:3, :3] @ centre + pose[:3, 3], 0)
