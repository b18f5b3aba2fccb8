"""Structure from motion on a rendered room: pose error against the truth, gaps that are explained, kills that are survived."""

import json
import shutil
import subprocess
import sys

import numpy as np
import pytest
from e4dgs.pipeline import StageError
from e4dgs.stages.poses.settings import PosesSettings
from e4dgs.stages.poses.stage import Poses
from e4dgs.stages.shared.frameset import FrameSet
from e4dgs.vision.sfm import runner
from e4dgs.vision.sfm.alignment import camera_centres, similarity
from e4dgs.vision.sfm.between.pose_between import spread
from e4dgs.vision.sfm.coverage import cover, runs, spans
from e4dgs.vision.sfm.pairs import choose, image_pairs
from e4dgs.vision.sfm.world import MEDIAN_DISTANCE, keep_points, normalise
from factory import Options, make, write_images
from PIL import Image
from pose_error import pose_error
from run_stage import run_poses

FRAMES = 9


@pytest.fixture(scope="module")
def room(tmp_path_factory):
    """9 frames 240x180 of a hand-held camera, and one black frame at the end that nothing can be matched with."""
    options = Options(backdrop="room", rig="path", times=FRAMES, width=240, height=180, samples=2, fov_degrees=60.0, motion=0.0)
    capture = write_images(make(options), tmp_path_factory.mktemp("room"))
    last = sorted(p for p in capture.root.rglob("*.*") if p.is_file())[-1]
    Image.fromarray(np.zeros((180, 240, 3), np.uint8)).save(last.with_name(f"{int(last.stem) + 1:0{len(last.stem)}d}{last.suffix}"))
    return capture


@pytest.fixture(scope="module")
def solved(room, tmp_path_factory):
    return run_poses(room.root, tmp_path_factory.mktemp("solved"))


@pytest.fixture(scope="module")
def truth(room) -> np.ndarray:
    return np.stack([view.camera.cam_from_world for view in room.synthetic.views])


def test_cameras_are_found_to_half_a_percent_of_the_path(solved, truth):
    registered = solved.artifact.read("registered")
    assert registered.tolist() == [True] * FRAMES + [False]
    error = pose_error(solved.artifact.read("cam_from_world")[:FRAMES], truth)
    assert error["percent"] < 0.5
    assert error["rotation_degrees"] < 0.5
    assert solved.artifact.attrs["mean_reprojection_error"] < 0.6


def test_intrinsics_are_found_without_exif(solved, room):
    K, true = solved.artifact.read("K"), room.synthetic.views[0].camera.K
    assert (K[:FRAMES] == K[0]).all(), "one camera, one K"
    assert K[0, 0, 0] == pytest.approx(true[0, 0], rel=0.02)
    assert np.allclose(K[0, :2, 2], true[:2, 2])


def test_rows_of_missing_frames_are_nan_and_the_frameset_leaves_them_out(solved):
    assert np.isnan(solved.artifact.read("cam_from_world")[FRAMES]).all()
    assert np.isnan(solved.artifact.read("K")[FRAMES]).all()
    frames = FrameSet(solved.context.inputs["frames"], solved.context.capture.root, solved.artifact)
    assert FRAMES not in {*frames.train, *frames.val, *frames.test}


def test_a_missing_frame_is_named_with_a_reason_and_a_remedy(solved):
    attrs = solved.artifact.attrs
    assert (attrs["registered"], attrs["total"], attrs["gaps"]) == (FRAMES, FRAMES + 1, [[FRAMES, FRAMES]])
    (sentence,) = attrs["advice"]
    assert "frame 9 did not register" in sentence and "fewer than 200 features" in sentence and "--set poses." in sentence
    assert sentence in solved.lines


def test_world_is_normalised_and_points_lie_in_front_of_the_cameras(solved):
    poses, points = solved.artifact.read("cam_from_world")[:FRAMES], solved.artifact.read("points")
    distance = np.linalg.norm(camera_centres(poses) - np.median(points, axis=0), axis=1)
    assert np.median(distance) == pytest.approx(MEDIAN_DISTANCE)
    depth = np.einsum("nj,pj->np", poses[:, 2, :3], points) + poses[:, 2, 3:]
    assert len(points) > 100 and (depth.max(axis=0) > 0).all()
    assert solved.artifact.read("point_colors").shape == points.shape
    assert solved.artifact.read("point_errors").max() <= 2.0


def test_a_second_run_gives_the_same_bits(solved, room, tmp_path):
    again = run_poses(room.root, tmp_path)
    for name in solved.artifact.names():
        assert np.array_equal(solved.artifact.read(name), again.artifact.read(name), equal_nan=name in ("K", "cam_from_world")), name
    assert solved.artifact.attrs == again.artifact.attrs


def test_frames_between_key_frames_are_as_exact(room, truth, tmp_path, monkeypatch):
    monkeypatch.setattr("e4dgs.vision.sfm.pairs.MOST_KEYS", 5)  # every second frame
    sparse = run_poses(room.root, tmp_path)
    assert sparse.artifact.read("registered").tolist() == [True] * FRAMES + [False]
    error = pose_error(sparse.artifact.read("cam_from_world")[:FRAMES], truth)
    assert error["percent"] < 0.5
    assert error["rotation_degrees"] < 0.5
    assert "used 5 frames; its points posed 4 of the 5 frames between them" in sparse.artifact.attrs["notes"][-1]


def test_if_key_frames_pose_too_few_all_frames_are_used(solved, room, tmp_path, monkeypatch):
    def none(frames, arrays, count, picture, advance):
        return spread(frames, {**arrays, "registered": np.zeros(len(frames), bool)}, count)

    monkeypatch.setattr("e4dgs.vision.sfm.pairs.MOST_KEYS", 5)
    monkeypatch.setattr("e4dgs.stages.poses.sparsely.pose_between", none)
    whole = run_poses(room.root, tmp_path)
    np.testing.assert_array_equal(whole.artifact.read("cam_from_world"), solved.artifact.read("cam_from_world"))


def test_a_killed_run_keeps_its_features(solved, tmp_path):
    folder = tmp_path / "colmap"
    request = json.loads((solved.context.checkpoints / "colmap" / "request.json").read_text())
    request["pairs"] = request["pairs"][:3]

    def stop(phase: str, done: int, total: int) -> None:
        if phase == "matches":
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        runner.run_worker(request, folder, stop)
    assert not (folder / "result.json").exists()
    steps: list[tuple[str, int, int]] = []
    _, facts = runner.run_worker(request, folder, lambda *step: steps.append(step))
    assert steps[0] == ("features", FRAMES + 1, FRAMES + 1), "nothing is extracted twice"
    assert len(facts["features"]) == FRAMES + 1


def test_a_capture_that_cannot_be_reconstructed_is_refused_with_a_remedy(tmp_path):
    folder = tmp_path / "capture"
    folder.mkdir()
    noise = np.random.default_rng(0)
    for i in range(4):  # nothing in one picture is in another
        Image.fromarray(noise.integers(0, 256, (96, 128, 3), dtype=np.uint8)).save(folder / f"{i:03d}.png")
    with pytest.raises(StageError, match=r"no cameras for the 4 frames .* features an image.*: most frames show fewer than 200 features"):
        run_poses(folder, tmp_path / "work")


def test_a_native_crash_is_one_error_with_the_signal(tmp_path, monkeypatch):
    program = tmp_path / "python"
    program.write_text("#!/bin/sh\necho 'check failed in solver' >&2\nkill -SEGV $$\n")
    program.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(program))
    with pytest.raises(runner.WorkerError, match=r"ended by SIGSEGV(.|\n)*check failed in solver"):
        runner.run_worker({"task": "reconstruct"}, tmp_path / "work")


def test_an_unknown_task_is_an_error_and_leaves_no_result(tmp_path):
    with pytest.raises(runner.WorkerError, match=r"exit code 1(.|\n)*unknown task 'dream'"):
        runner.run_worker({"task": "dream"}, tmp_path)


def test_planning_imports_nothing_heavy():
    code = (
        "import sys, e4dgs.stages.poses.stage as p\n"
        "facts = dict(poses=False, frames=90, width=480, height=270, static=False)\n"
        "assert p.Poses().applies(facts, p.PosesSettings()).needed and p.Poses().estimate(facts, p.PosesSettings()) > 10\n"
        "print([m for m in ('torch', 'cv2', 'pycolmap', 'scipy', 'zarr') if m in sys.modules])"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout.strip() == "[]"


def test_poses_in_the_files_need_no_sfm():
    applies = Poses().applies({"poses": True, "frames": 3}, PosesSettings())
    assert not applies.needed and "files hold poses" in applies.reason


@pytest.mark.parametrize(
    ("matcher", "images", "static", "expected"),
    [
        (None, 40, False, "exhaustive"),
        (None, 41, False, "sequential"),
        (None, 41, True, "exhaustive"),
        ("sequential", 5, True, "sequential"),
    ],
)
def test_auto_matches_all_pairs_of_few_or_unordered_images(matcher, images, static, expected):
    assert choose(matcher, images, static) == expected


def test_sequential_pairs_hold_neighbours_longer_steps_and_loops():
    pairs = set(image_pairs("sequential", 300, overlap=10))
    assert all((i, i + 10) in pairs for i in range(290)), "each image and the next ones"
    assert [i for i in range(236) if (i, i + 64) in pairs] == list(range(0, 236, 6)), "far ones are few, but everywhere"
    assert (0, 299 // 13 * 13) in pairs, "first and last keyframe close the loop"
    assert all(a < b for a, b in pairs) and len(pairs) < 300 * 13
    assert image_pairs("exhaustive", 4) == [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)]


def test_similarity_recovers_what_was_applied():
    rng = np.random.default_rng(1)
    points, scale, t = rng.normal(size=(20, 3)), 2.5, np.array([1.0, -2.0, 3.0])
    R, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    R *= np.sign(np.linalg.det(R))
    found = similarity(points, scale * points @ R.T + t)
    assert found[0] == pytest.approx(scale)
    assert np.allclose(found[1], R) and np.allclose(found[2], t)


def test_similarity_refuses_points_on_a_line():
    line = np.outer(np.arange(5.0), [1, 2, 3])
    with pytest.raises(ValueError, match="on a line"):
        similarity(line, line)


def test_pose_error_is_zero_for_a_similar_world_and_counts_a_shift(truth):
    poses, _ = normalise(truth, np.array([[0.0, 0.0, 1.0]]))
    assert pose_error(poses, truth)["percent"] < 1e-9
    moved = truth.copy()
    moved[4, :3, 3] += 0.1
    error = pose_error(moved, truth)
    assert 0.1 < error["max"] <= 0.1 * 3**0.5 and error["percent"] == pytest.approx(100 * error["rms"] / error["path"])


def test_points_that_are_wrong_far_or_seen_twice_are_dropped():
    points = np.random.default_rng(2).normal(size=(203, 3))
    errors, tracks = np.full(203, 0.5), np.full(203, 4)
    errors[0], points[1], tracks[2] = 2.5, 1e4, 2
    assert np.flatnonzero(~keep_points(points, errors, tracks)).tolist() == [0, 1, 2]
    assert keep_points(points[3:20], errors[3:20], np.full(17, 2)).all(), "pairs are better than nothing"


def test_coverage_names_runs_parts_and_error():
    missing = np.zeros(60, bool)
    missing[[3, *range(40, 53)]] = True
    assert runs(missing) == ((3, 3), (40, 52))
    assert spans([(i, i) for i in range(0, 20, 2)]) == "0, 2, 4, 6, 8, 10, 12, 14 and 2 more"
    coverage = cover(~missing, [900] * 60, [46, 12, 1], "sequential", 1.8)
    assert coverage.summary() == "46 of 60 frames registered; without a pose: 3, 40-52"
    gaps, parts, error = coverage.advice
    assert "frames 3, 40-52 did not register: motion blur" in gaps and "poses.matcher=exhaustive" in gaps
    assert "2 parts" in parts and "(46, 12 images)" in parts and "1.80 px" in error
    assert cover(np.ones(5, bool), [900] * 5, [5], "exhaustive", 0.5).advice == ()
    (narrow,) = cover(np.ones(5, bool), [900] * 5, [5], "exhaustive", 0.5, angle=1.2).advice
    assert "a median angle of 1.2 degrees" in narrow and "frames.every" in narrow


@pytest.mark.parametrize(("scene", "frames"), [("balloon1/images", 12), ("sceaux/images", 11)])
def test_real_captures_register_whole(shared_scenes, tmp_path, scene, frames):
    """At a quarter of the pixels, to stay quick; benchmarks/sfm_pose_error.py measures them in full."""
    small = tmp_path / "small"
    small.mkdir()
    for file in sorted((shared_scenes / scene).glob("*.[jJ]*")):
        with Image.open(file) as image:
            image.reduce(3).save(small / file.name, quality=95)
    result = run_poses(small, tmp_path / "work")
    assert result.artifact.attrs["registered"] == frames
    assert result.artifact.attrs["mean_reprojection_error"] < 0.6
    shutil.rmtree(tmp_path / "work")


def test_photos_that_lie_in_their_files_are_matched_upright(room, truth, tmp_path):
    """COLMAP reads pictures as they are stored, so it is not given the files of a phone that was held upright."""
    folder = tmp_path / "phone"
    folder.mkdir()
    exif = Image.Exif()
    exif[0x0112] = 6  # turn clockwise to see
    exif.get_ifd(0x8769)[0xA405] = 31  # mm on 35 mm film: 60 degrees
    for name in room.files:
        Image.open(room.root / name).transpose(Image.Transpose.ROTATE_90).save(folder / name, exif=exif)
    ran = run_poses(folder, tmp_path / "out", moving=False)
    assert pose_error(ran.artifact.read("cam_from_world"), truth)["percent"] < 0.5
    K, true = ran.artifact.read("K"), room.synthetic.views[0].camera.K
    assert K[0, 0, 0] == pytest.approx(true[0, 0], rel=0.02) and np.allclose(K[0, :2, 2], true[:2, 2])
    written = sorted((tmp_path / "out/checkpoints/poses/images").iterdir())
    assert Image.open(written[0]).size == (240, 180) and dict(Image.open(written[0]).getexif().get_ifd(0x8769)) == {0xA405: 31}


def test_photos_of_two_sizes_have_a_lens_each(tmp_path):
    sizes = ((240, 180), (240, 180), (300, 240))
    options = Options(backdrop="room", rig="path", times=FRAMES, sizes=sizes, samples=2, fov_degrees=60.0, motion=0.0)
    capture = write_images(make(options), tmp_path / "photos")
    ran = run_poses(capture.root, tmp_path / "out", moving=False)
    assert ran.artifact.read("registered").all()
    assert pose_error(ran.artifact.read("cam_from_world"), np.stack([v.camera.cam_from_world for v in capture.views]))["percent"] < 0.7
    focal = ran.artifact.read("K")[:, 0, 0]
    # 300x240 is scaled to 240x192, and 6 rows go at the top and at the bottom: the same field of view across
    assert focal == pytest.approx(capture.views[0].camera.K[0, 0], rel=0.03)
    assert len(set(focal)) == 2
