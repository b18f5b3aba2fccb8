"""Poses that follow something else than most matches do: they are found out, their frames are masked by flow alone, and people are told."""

import dataclasses
from unittest.mock import MagicMock as Mock

import numpy as np
import pycolmap
import pytest
from e4dgs.stages.poses import second_pass
from e4dgs.stages.poses.moving_masks import FEWEST, lens_moving_masks
from e4dgs.stages.shared.frameset import FrameSet
from e4dgs.vision.sfm.coverage import cover
from e4dgs.vision.sfm.epipolar import fundamental
from e4dgs.vision.sfm.pose_agreement import DOUBTFUL, SUPPORT, doubtful, explained
from e4dgs.vision.sfm.worker.survey import free_pairs
from factory import Box, Cells, Motion, Object, Options, make, render, write_images
from run_stage import run_frames, run_poses

WIDTH, HEIGHT, TIMES = 240, 180, 8
MOTION = Motion((0.0, -0.3, 0.55), turn=3.0)
FOLLOWING = np.isin(np.arange(TIMES), [3, 4, 5])  # frames whose poses will follow the box


@pytest.fixture(scope="module")
def busy(tmp_path_factory):
    """A hand-held camera in a room, before it a textured box that turns, over a quarter of the picture."""
    options = Options(backdrop="room", rig="path", boxes=0, spheres=0, times=18, width=WIDTH, height=HEIGHT, samples=2, fov_degrees=60.0)
    made = make(options)
    room = dataclasses.replace(made.scene.objects[0], texture=Cells(0.3))
    scene = dataclasses.replace(made.scene, objects=(room, Object("box", Box((0.55, 0.55, 0.55)), Cells(0.25, 1), MOTION)))
    return write_images(dataclasses.replace(made, scene=scene, views=made.views[4 : 4 + TIMES]), tmp_path_factory.mktemp("busy"))


@pytest.fixture(scope="module")
def box(busy) -> np.ndarray:
    """[F, H, W] bool: where the box is."""
    return np.stack([render(busy.synthetic.scene, view.camera, view.time, samples=1).object > 0 for view in busy.synthetic.views])


def arrays_of(busy, following: np.ndarray) -> dict[str, np.ndarray]:
    """Arrays of a first pass with the true cameras; in the frames `following`, the cameras as they are relative to the box."""
    views = busy.synthetic.views
    middle = MOTION.world_from_object(views[TIMES // 2].time)
    relative = [v.camera.cam_from_world @ MOTION.world_from_object(v.time) @ np.linalg.inv(middle) for v in views]
    poses = np.stack([r if follows else v.camera.cam_from_world for r, v, follows in zip(relative, views, following, strict=True)])
    return {
        "registered": np.ones(TIMES, bool),
        "K": np.stack([v.camera.K for v in views]),
        "cam_from_world": poses,
        "distortion": np.zeros((TIMES, 4)),
        "size": np.tile([WIDTH, HEIGHT], (TIMES, 1)),
    }


def pairs_of(busy, count: int = 400):
    """Matches of neighbouring frames: three quarters in the room, an eighth on the box, an eighth wrong; and each pair's own matrix."""
    random = np.random.default_rng(0)
    views, room, on_box, wrong = busy.synthetic.views, count * 3 // 4, count // 8, count // 8
    points = random.uniform([-1.5, 0.5, 0.0], [1.5, 1.5, 1.5], (room, 3))
    corners = np.column_stack([random.uniform(-0.27, 0.27, (on_box, 3)), np.ones(on_box)])
    for i in range(TIMES - 1):
        places = []
        for view in views[i : i + 2]:
            world = np.concatenate([points, (corners @ MOTION.world_from_object(view.time).T)[:, :3]])
            local = world @ view.camera.cam_from_world[:3, :3].T + view.camera.cam_from_world[:3, 3]
            xy = local @ view.camera.K.T
            places.append(np.concatenate([xy[:, :2] / xy[:, 2:], random.uniform(0, [WIDTH, HEIGHT], (wrong, 2))]))
        first, second = views[i].camera, views[i + 1].camera
        yield i, i + 1, *places, fundamental(first.K, second.K, first.cam_from_world, second.cam_from_world)


def test_true_cameras_explain_what_pairs_do_and_cameras_that_follow_a_box_do_not(busy):
    true = explained(pairs_of(busy), arrays_of(busy, np.zeros(TIMES, bool)))
    assert np.allclose(true, 1.0), "however many matches are wrong or on the box"
    arrays = arrays_of(busy, FOLLOWING)
    arrays["explained"] = explained(pairs_of(busy), arrays)
    assert np.array_equal(doubtful(arrays)[FOLLOWING], np.ones(3, bool)) and arrays["explained"][FOLLOWING].max() < 0.5
    assert not doubtful(arrays)[[0, 1, 7]].any(), "only their neighbours may be doubted with them"


def test_frames_without_a_pose_or_a_pair_are_not_doubted(busy):
    arrays = arrays_of(busy, FOLLOWING)
    assert not doubtful(arrays).any(), "nothing is known about them"
    arrays["registered"][3] = False
    arrays["explained"] = explained((pair for pair in pairs_of(busy) if pair[1] < 6), arrays)
    assert np.isnan(arrays["explained"][[3, 6, 7]]).all() and np.flatnonzero(doubtful(arrays)).tolist() == [4, 5]


def test_frames_are_judged_only_by_most_of_their_matches(busy):
    arrays = arrays_of(busy, FOLLOWING)

    def judged(share: float) -> np.ndarray:
        """`share` of the matches are in the pairs of `pairs_of`, the others in pairs that a homography explains."""
        more = np.zeros((round(400 / share) - 400, 2))
        return np.isfinite(explained([*pairs_of(busy), *((i, i + 1, more, more, None) for i in range(TIMES - 1))], arrays))

    assert judged(SUPPORT).all() and not judged(SUPPORT - 0.01).any()


def test_doubtful_frames_are_masked_by_flow_alone(busy, box, tmp_path):
    ran = run_frames(busy.root, tmp_path)
    frames = FrameSet(ran.artifact, ran.context.capture.root)
    arrays, advanced = arrays_of(busy, FOLLOWING), []
    cameras = [arrays[name] for name in ("K", "cam_from_world", "distortion", "size")]

    def overlap(masks: np.ndarray, chosen: np.ndarray) -> float:
        return float((masks & box)[chosen].sum() / (masks | box)[chosen].sum())

    misled = lens_moving_masks(frames, *cameras, lambda: None)
    assert overlap(misled, FOLLOWING) < 0.5, "relative to the box, the room moves"
    masks = lens_moving_masks(frames, *cameras, lambda: advanced.append(1), FOLLOWING)
    assert len(advanced) == TIMES
    assert overlap(masks, FOLLOWING) > 0.7 and overlap(masks, ~FOLLOWING) > 0.7


def test_the_second_pass_puts_doubtful_poses_aside_and_says_so(tmp_path, monkeypatch):
    first = {"registered": np.ones(FEWEST, bool), "explained": np.full(FEWEST, DOUBTFUL), "size": np.tile([20, 10], (FEWEST, 1))}
    first["explained"][[1, 2]] = DOUBTFUL - 0.01
    first |= {name: np.zeros(1) for name in ("K", "cam_from_world", "distortion")}
    first |= {"seen": np.zeros(10, int), "seen_xy": np.zeros((10, 2), np.float32)}
    asides = []
    monkeypatch.setattr(second_pass, "lens_moving_masks", lambda *given: asides.append(given[-1]) or np.zeros((FEWEST, 10, 20), bool))
    frames = Mock(camera=np.zeros(FEWEST, int), __len__=lambda _: FEWEST)
    passes = second_pass.second_pass(frames, {}, tmp_path, (first, {}), False, lambda *_: None)
    assert np.flatnonzero(asides[0]).tolist() == [1, 2]
    assert "found without poses in frames 1-2" in passes.told


def test_matches_and_own_matrices_are_read_from_the_database(busy, tmp_path):
    path, given = tmp_path / "database.db", list(pairs_of(busy))[:2]
    (a, b, xy1, xy2, F), (_, c, _, xy3, _) = given
    count = len(xy1)
    matches = np.column_stack([np.arange(count)] * 2).astype(np.uint32)
    with pycolmap.Database.open(path) as database:
        camera = database.write_camera(pycolmap.Camera.create_from_model_name(0, "SIMPLE_PINHOLE", 200.0, WIDTH, HEIGHT))
        ids = [database.write_image(pycolmap.Image(name=f"{i}.png", camera_id=camera)) for i in range(3)]
        for image, xy in zip(ids, (xy1, xy2, xy3), strict=True):
            database.write_keypoints(image, xy.astype(np.float32))
        for first, second, own in ((a, b, {"F": F}), (b, c, {"H": np.eye(3)})):
            database.write_matches(ids[first], ids[second], matches)
            kind = pycolmap.TwoViewGeometryConfiguration.UNCALIBRATED if "F" in own else pycolmap.TwoViewGeometryConfiguration.PLANAR
            geometry = pycolmap.TwoViewGeometry({"config": kind, "inlier_matches": matches[:20], **own})
            database.write_two_view_geometry(ids[first], ids[second], geometry)
    read, flat = free_pairs(path, [f"{i}.png" for i in range(3)], [(0, 1), (1, 2), (0, 2)])
    assert read[:2] == (0, 1) and flat[:2] == (1, 2) and flat[4] is None
    assert np.allclose(read[2], xy1, atol=1e-3) and np.allclose(read[3], xy2, atol=1e-3) and np.allclose(read[4], F)


def test_a_pass_gives_the_measure_for_every_frame_and_doubts_no_good_pose(busy, tmp_path):
    solved = run_poses(busy.root, tmp_path, max_features=700)
    for folder in ("colmap", "colmap/masked"):
        with np.load(solved.context.checkpoints / folder / "result.npz") as arrays:
            assert arrays["explained"].shape == (TIMES,) and not doubtful(dict(arrays)).any()
    assert not any("doubtful" in line for line in solved.lines)


def test_people_are_told_which_poses_are_doubtful():
    (advice,) = cover(np.ones(9, bool), [900] * 9, [9], "exhaustive", 0.5, doubtful=np.arange(9) < 4).advice
    assert advice.startswith("frames 0-3: the poses are doubtful")
    assert cover(np.ones(9, bool), [900] * 9, [9], "exhaustive", 0.5, doubtful=np.zeros(9, bool)).advice == ()
