"""Structure from motion beside what moves: which features lie on it, when a second pass runs, which pass is kept, what a kill leaves."""

import dataclasses
import shutil
from types import SimpleNamespace

import numpy as np
import pytest
from e4dgs.stages.poses import second_pass
from e4dgs.stages.poses.moving_masks import FEWEST, lens_moving_masks
from e4dgs.stages.poses.second_pass import LEAST, choose_pass, needless
from e4dgs.stages.shared.frameset import FrameSet
from e4dgs.vision.sfm import runner
from e4dgs.vision.sfm.masks import on_moving, static_matches
from e4dgs.vision.sfm.pose_agreement import Matches, agreement
from factory import Box, Cells, Motion, Object, Options, make, render, write_images
from pose_error import pose_error
from run_stage import run_frames, run_poses

WIDTH, HEIGHT, TIMES = 240, 180, 8
FEATURES = 700  # an image


@pytest.fixture(scope="module")
def busy(tmp_path_factory):
    """A hand-held camera in a room, before it a textured box that turns, over a quarter of the picture; the middle of a longer path."""
    options = Options(backdrop="room", rig="path", boxes=0, spheres=0, times=18, width=WIDTH, height=HEIGHT, samples=2, fov_degrees=60.0)
    made = make(options)
    room = dataclasses.replace(made.scene.objects[0], texture=Cells(0.3))
    box = Object("box", Box((0.55, 0.55, 0.55)), Cells(0.25, 1), Motion((0.0, -0.3, 0.55), turn=3.0))
    scene = dataclasses.replace(made.scene, objects=(room, box))
    return write_images(dataclasses.replace(made, scene=scene, views=made.views[4 : 4 + TIMES]), tmp_path_factory.mktemp("busy"))


@pytest.fixture(scope="module")
def truth(busy) -> np.ndarray:
    return np.stack([view.camera.cam_from_world for view in busy.synthetic.views])


@pytest.fixture(scope="module")
def solved(busy, tmp_path_factory):
    return run_poses(busy.root, tmp_path_factory.mktemp("solved"), max_features=FEATURES)


@pytest.fixture(scope="module")
def box(busy) -> np.ndarray:
    """[F, H, W] bool: where the box is."""
    return np.stack([render(busy.synthetic.scene, view.camera, view.time, samples=1).object > 0 for view in busy.synthetic.views])


def posed(truth: np.ndarray, busy) -> dict[str, np.ndarray]:
    """Arrays as a first pass would give them that found the true cameras."""
    count = len(truth)
    return {
        "registered": np.ones(count, bool),
        "K": np.stack([view.camera.K for view in busy.synthetic.views]),
        "cam_from_world": truth.copy(),
        "distortion": np.zeros((count, 4)),
        "size": np.tile([WIDTH, HEIGHT], (count, 1)),
    }


def test_a_second_pass_without_moving_pixels_runs_and_is_no_worse(solved, truth, box):
    attrs = solved.artifact.attrs
    assert box.mean() > 0.2
    assert 0.01 < attrs["moving_share"] < 1 and attrs["registered"] == TIMES
    assert (solved.context.checkpoints / "colmap" / "masked" / "result.json").is_file()
    assert "of the features used lie on moving objects" in attrs["second_pass"] and "is kept: its cameras explain" in attrs["second_pass"]
    assert f"moving objects: {attrs['second_pass']}" in solved.lines
    with np.load(solved.context.checkpoints / "colmap" / "result.npz") as first:
        before = pose_error(first["cam_from_world"], truth)
    after = pose_error(solved.artifact.read("cam_from_world"), truth)
    assert after["percent"] < 0.1 and after["percent"] <= before["percent"] + 0.02


@pytest.fixture(scope="module")
def killed(busy, tmp_path_factory):
    """The folder of a run that was interrupted when its second pass had begun to register."""
    folder = tmp_path_factory.mktemp("killed")

    def stop(request, below, progress=None):
        def watch(phase: str, done: int, total: int) -> None:
            if phase == "mapping":
                raise KeyboardInterrupt

        return runner.run_worker(request, below, watch)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(second_pass, "run_worker", stop)
        with pytest.raises(KeyboardInterrupt):
            run_poses(busy.root, folder, max_features=FEATURES)
    return folder


@pytest.fixture
def resumed(killed):
    """The same folder for another run, without the artifacts that the runner would have thrown away."""
    for name in ("frames", "poses"):
        shutil.rmtree(killed / name)
    return killed


def test_off_leaves_the_first_pass(busy, resumed):
    off = run_poses(busy.root, resumed, moving=False, max_features=FEATURES)
    assert off.artifact.attrs["moving_share"] is None and off.artifact.attrs["second_pass"] == "poses.moving=off"
    assert not any("moving objects" in line for line in off.lines)
    with np.load(resumed / "checkpoints" / "poses" / "colmap" / "result.npz") as first:
        assert np.array_equal(first["cam_from_world"][:, :3, :3], off.artifact.read("cam_from_world")[:, :3, :3])


def test_a_second_pass_that_crashes_leaves_the_first(busy, resumed, monkeypatch):
    def crash(*_):
        raise runner.WorkerError("COLMAP was ended by SIGSEGV. The end of its log: ...")

    monkeypatch.setattr(second_pass, "run_worker", crash)
    result = run_poses(busy.root, resumed, max_features=FEATURES)
    assert "the second pass without them failed, the first is kept" in result.artifact.attrs["second_pass"]
    assert result.artifact.attrs["registered"] == TIMES and any("SIGSEGV" in line for line in result.lines)


def test_a_run_killed_in_the_second_pass_goes_on_there(busy, resumed, solved, monkeypatch):
    tasks: list[str] = []

    def watched(request, *rest):
        tasks.append(request["task"])
        return original(request, *rest)

    original = runner.run_worker
    for module in (runner, second_pass):
        monkeypatch.setattr(module, "run_worker", watched)
    monkeypatch.setattr(second_pass, "lens_moving_masks", lambda *_: pytest.fail("the masks were there"))
    again = run_poses(busy.root, resumed, max_features=FEATURES)
    assert tasks == ["reconstruct_masked"], "what the first pass found was kept"
    assert np.array_equal(again.artifact.read("cam_from_world"), solved.artifact.read("cam_from_world"))


def test_masks_lie_on_the_box_and_frames_without_a_pose_have_none(busy, truth, box, tmp_path):
    ran = run_frames(busy.root, tmp_path)
    frames = FrameSet(ran.artifact, ran.context.capture.root)
    arrays, advanced = posed(truth, busy), []
    arrays["cam_from_world"][3] = np.nan
    arrays["K"][3] = np.nan
    values = [arrays[name] for name in ("K", "cam_from_world", "distortion", "size")]
    masks = lens_moving_masks(frames, *values, lambda: advanced.append(1))
    assert masks.shape == box.shape and len(advanced) == TIMES
    assert not masks[3].any()
    others = np.arange(TIMES) != 3
    assert (masks & box)[others].sum() / (masks | box)[others].sum() > 0.75


def test_masks_follow_the_lens(busy):
    """A mask of the pinhole image is bent as the picture is: what was masked is what is shown there."""
    from e4dgs.stages.poses.moving_masks import _Lens
    from e4dgs.vision.images.pictures import undistort

    K, terms = busy.synthetic.views[0].camera.K, np.array([0.4, 0.0, 0.0, 0.0])
    lens = _Lens(K[None], terms[None], WIDTH, HEIGHT)
    straight = np.zeros((HEIGHT, WIDTH), np.uint8)
    straight[30:90, 150:210] = 255
    bent = lens.seen(straight)
    back = undistort(np.dstack([bent] * 3), lens._to)[..., 0] > 127
    assert (bent != straight).mean() > 0.01
    assert (back & (straight > 0)).sum() / (back | (straight > 0)).sum() > 0.95
    assert _Lens(K[None], np.zeros((1, 4)), WIDTH, HEIGHT).seen(straight) is straight


@pytest.mark.parametrize(("share", "runs"), [(LEAST, True), (LEAST - 1e-3, False)])
def test_the_second_pass_runs_from_the_threshold_on(share, runs, tmp_path, monkeypatch):
    count = 1000
    places = np.zeros((count, 2), np.float32)
    places[: round(share * count)] = 15.0, 5.0  # on the masked half
    masks = np.zeros((FEWEST, 10, 20), bool)
    masks[0, :, 10:] = True
    first = {"registered": np.ones(FEWEST, bool), "size": np.tile([20, 10], (FEWEST, 1)), "seen_xy": places}
    first["seen"] = np.zeros(count, int)  # all in frame 0
    calls = []
    monkeypatch.setattr(second_pass, "_masks", lambda *_: masks)
    monkeypatch.setattr(second_pass, "run_worker", lambda *_: calls.append(1) or ({"new": np.ones(1)}, {}))
    monkeypatch.setattr(second_pass, "choose_pass", lambda *_: (True, "better"))
    frames = SimpleNamespace(camera=np.zeros(FEWEST, int))
    passes = second_pass.second_pass(frames, {}, tmp_path, (first, {}), False, lambda *_: None)
    assert bool(calls) is runs and ("new" in passes.arrays) is runs
    assert passes.moving_share == pytest.approx(share)
    assert ("no second pass" in passes.told) is not runs


def test_static_captures_and_a_handful_of_frames_are_not_looked_at():
    frames = SimpleNamespace(camera=np.array([0] * FEWEST + [1] * 3))
    assert needless(frames, False, np.ones(FEWEST + 3, bool)) is None
    assert "static" in needless(frames, True, np.ones(FEWEST + 3, bool))
    registered = np.ones(FEWEST + 3, bool)
    registered[0] = False
    assert f"no camera has {FEWEST} frames with a pose" in needless(frames, False, registered)


def test_places_are_looked_up_at_the_size_of_the_mask():
    masks = np.zeros((2, 4, 8), bool)
    masks[1, 1, 2] = True  # pixels 20..30 x 10..20 of the picture
    xy = np.array([[20.0, 10.0], [29.9, 19.9], [30.0, 10.0], [20.0, 9.9], [20.0, 10.0], [-3.0, 500.0]])
    frame = np.array([1, 1, 1, 1, 0, 1])
    assert on_moving(masks, frame, xy, np.array([[80, 40], [80, 40]])).tolist() == [True, True, False, False, False, False]
    assert on_moving(masks, np.zeros(0, int), np.zeros((0, 2)), np.array([[80, 40]])).shape == (0,)


def test_a_match_goes_when_either_end_is_on_a_moving_object():
    matches = np.array([[0, 0], [1, 0], [0, 1], [1, 1]], np.uint32)
    assert static_matches(matches, np.array([False, True]), np.array([False, True])).tolist() == [[0, 0]]
    assert static_matches(np.zeros((0, 2), np.uint32), np.zeros(0, bool), np.zeros(0, bool)).shape == (0, 2)


def exact_matches(truth: np.ndarray, busy, count: int = 200) -> Matches:
    """Of points in the room, seen by neighbouring frames."""
    points = np.random.default_rng(0).uniform([-1.5, 0.5, 0.0], [1.5, 1.5, 1.5], (count, 3))
    K = busy.synthetic.views[0].camera.K
    local = np.einsum("nij,pj->npi", truth[:, :3, :3], points) + truth[:, None, :3, 3]
    xy = (local @ K.T)[..., :2] / local[..., 2:]
    pairs = np.array([(i, i + 1) for i in range(len(truth) - 1)])
    return Matches(np.repeat(pairs, count, axis=0), xy[:-1].reshape(-1, 2), xy[1:].reshape(-1, 2))


def test_true_cameras_explain_exact_matches_and_turned_ones_do_not(truth, busy):
    matches, arrays = exact_matches(truth, busy), posed(truth, busy)
    every = np.ones(TIMES, bool)
    assert agreement(matches, arrays, every) == 1.0
    wrong = matches.xy2.copy()
    wrong[::4] += 40.0 * np.array([0.0, 1.0])
    assert agreement(Matches(matches.pair, matches.xy1, wrong), arrays, every) == pytest.approx(0.75, abs=0.02)
    turned = {**arrays, "cam_from_world": truth.copy()}
    angle = np.radians(3.0)
    turn = np.array([[1, 0, 0], [0, np.cos(angle), -np.sin(angle)], [0, np.sin(angle), np.cos(angle)]])
    turned["cam_from_world"][4, :3] = turn @ truth[4, :3]
    assert agreement(matches, turned, every) == pytest.approx(1 - 2 / (TIMES - 1), abs=0.05), "both pairs of frame 4 are off"
    every[4] = False
    assert agreement(matches, turned, every) == 1.0, "frames that are left out do not count"
    assert np.isnan(agreement(matches, arrays, np.zeros(TIMES, bool)))


def test_more_frames_win_then_what_the_cameras_explain(truth, busy):
    matches, good = exact_matches(truth, busy), posed(truth, busy)
    judged = {"match_pair": matches.pair, "match_xy1": matches.xy1, "match_xy2": matches.xy2}
    bad = {**good, "cam_from_world": truth.copy()}
    bad["cam_from_world"][2, 1, 3] += 0.2
    assert choose_pass(bad, {**good, **judged})[0]
    kept, words = choose_pass(good, {**bad, **judged})
    assert not kept and words.startswith("the first pass is kept: its cameras explain 100.00 %")
    assert not choose_pass(good, {**good, **judged})[0], "no better, so the simpler one"
    fewer = {**good, "registered": np.arange(TIMES) != 1}
    assert choose_pass(fewer, {**bad, **judged}) == (
        True,
        "the second pass, without them, is kept: 8 frames registered in it, 7 in the other",
    )
    assert not choose_pass(bad, {**fewer, **judged})[0]


def test_results_are_found_again_for_the_same_request_alone(tmp_path):
    request = {"task": "dream", "pairs": [(0, 1)]}
    assert runner.finished(request, tmp_path) is None
    with pytest.raises(runner.WorkerError):
        runner.run_worker(request, tmp_path)
    assert runner.finished(request, tmp_path) is None, "it failed"
    np.savez(tmp_path / "result.npz", a=np.arange(3))
    (tmp_path / "result.json").write_text("{}")
    arrays, facts = runner.finished(request, tmp_path)
    assert arrays["a"].tolist() == [0, 1, 2] and facts == {}
    assert runner.finished({**request, "task": "other"}, tmp_path) is None
    (tmp_path / "result.json").write_text('{"cut')
    assert runner.finished(request, tmp_path) is None


def test_refining_undoes_what_outliers_did_to_the_focal_length():
    """Exact synthetic features, one in twenty moved by 3 px: least squares bends the camera, Cauchy's loss does not."""
    pycolmap = pytest.importorskip("pycolmap")
    from e4dgs.vision.sfm.worker.refine import refine

    options = pycolmap.SyntheticDatasetOptions()
    options.num_rigs, options.num_cameras_per_rig, options.num_frames_per_rig, options.num_points3D = 1, 1, 8, 150
    pycolmap.set_random_seed(0)
    model = pycolmap.synthesize_dataset(options)
    (camera,) = model.cameras.values()
    focal = camera.mean_focal_length()
    rng = np.random.default_rng(0)
    for image_id in model.reg_image_ids():
        for feature in model.image(image_id).points2D:
            feature.xy = feature.xy + rng.normal(0, 0.1, 2) + (rng.random() < 0.05) * np.array([3.0, 3.0])
    plain = pycolmap.BundleAdjustmentOptions()
    plain.print_summary = False
    pycolmap.bundle_adjustment(model, plain)
    before = abs(model.cameras[camera.camera_id].mean_focal_length() / focal - 1)
    refine(model)
    after = abs(model.cameras[camera.camera_id].mean_focal_length() / focal - 1)
    assert after < 1e-3 and after < 0.5 * before
