"""Measured flow against exact flow, its confidence, edge weights, masks of what moves, and that held-out frames are never read."""

import sys
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
import torch
from e4dgs.pipeline import Artifact, StageError
from e4dgs.scene.edges import edge_weights
from e4dgs.stages.flow.artifact import StoredFlow
from e4dgs.stages.flow.choose_pairs import choose_pairs
from e4dgs.stages.flow.settings import FlowSettings
from e4dgs.stages.flow.stage import Flow
from e4dgs.stages.shared.frameset import FrameSet
from e4dgs.stages.shared.measured import measured_flow
from e4dgs.vision.flow.method import Dis, FlowMethod
from e4dgs.vision.flow.raft.architecture import SMALL
from e4dgs.vision.flow.two_way import FlowPair, consistency, dis_flow, trusted
from e4dgs.vision.flow.two_way import both_ways as measured
from e4dgs.vision.moving.motion_mask import MotionMask, motion_mask
from factory import Options, make, optical_flow, render, write_n3v, write_nerfstudio
from raft_weights import random_state, torchvisions
from run_stage import run_frames, run_stage
from safetensors.torch import save_file

SHARED = Path(__file__).resolve().parents[2].parent / "shared"
BASE = {"static": False, "pairs": 10, "width": 64, "height": 48, "frames": 11}


def run(capture_path, folder: Path, holdout: int = 8, detect_static: bool = False, **settings) -> tuple[Artifact, FrameSet]:
    """`frames`, then `flow`."""
    frames = run_frames(capture_path, folder, holdout=holdout)
    capture, options = frames.context.capture, FlowSettings(detect_static=detect_static, **settings)
    flow = run_stage(Flow(), capture, folder, options, {"frames": frames.artifact, "poses": None})
    return flow.artifact, FrameSet(frames.artifact, capture.root)


def both_ways(first: np.ndarray, second: np.ndarray, method: FlowMethod | None = None) -> FlowPair:
    method = method or Dis()
    return trusted(*measured(method, method.prepare(first), method.prepare(second)))


def pattern(height: int = 96, width: int = 128, seed: int = 0) -> np.ndarray:
    noise = np.random.default_rng(seed).integers(0, 256, (height // 4, width // 4, 3), dtype=np.uint8)
    return cv2.resize(noise, (width, height), interpolation=cv2.INTER_CUBIC)


@pytest.mark.parametrize(
    ("facts", "needed", "words"),
    [
        ({**BASE, "pairs": 0, "cameras": 11}, False, "every image has its own camera: no two frames of one camera to compare"),
        ({**BASE, "pairs": 0, "cameras": 1, "frames": 2}, False, "no two training frames of one camera to compare"),
        ({**BASE, "pairs": 1}, True, "1 pair of neighbouring frames"),
        ({**BASE, "static": True}, False, "static capture"),
        (BASE, True, "10 pairs"),
        ({**BASE, "pairs": 9000, "cameras": 1}, True, "600 of 9000 pairs"),
        ({**BASE, "pairs": 9000, "cameras": 2}, True, "400 of 9000 pairs"),
    ],
)
def test_the_plan_says_whether_and_why(facts, needed, words):
    answer = Flow().applies(facts, FlowSettings())
    assert answer.needed is needed and words in answer.reason
    assert Flow().estimate(facts, FlowSettings()) > 0


def test_flow_of_a_shift_has_its_sign_size_and_confidence():
    image = pattern()
    moved = np.roll(image, (2, 3), (0, 1))  # content moves 3 px right and 2 px down
    pair = both_ways(image, moved)
    inner = np.s_[16:-16, 16:-16]
    assert np.abs(pair.forward[inner] - [3, 2]).mean() < 0.1
    assert np.abs(pair.backward[inner] + [3, 2]).mean() < 0.1
    assert pair.confidence[inner].mean() > 250


def test_a_pixel_that_leaves_the_picture_or_is_covered_has_no_confidence():
    forward = np.zeros((20, 30, 2), np.float32)
    forward[..., 0] = 4
    backward = -forward
    weight = consistency(forward, backward)
    assert (weight[:, :26] == 255).all() and (weight[:, 26:] == 0).all()
    backward[:, 10:20, 0] = 0  # what lies there came from elsewhere
    assert (consistency(forward, backward)[:, 7:15] == 0).all()


def test_smaller_working_size_gives_flow_in_full_pixels():
    image = pattern(192, 256)
    moved = np.roll(image, 6, 1)
    method = Dis(max_size=128)
    flow = method.flow(method.prepare(image), method.prepare(moved))
    assert flow.shape == (192, 256, 2)
    assert np.abs(flow[32:-32, 32:-32] - [6, 0]).mean() < 0.3


@pytest.mark.parametrize("size", [(1, 1), (1, 300), (8, 8), (15, 40), (31, 200)])
def test_small_pictures_have_a_finite_answer(size):
    rng = np.random.default_rng(0)
    first, second = (rng.integers(0, 256, (*size, 3), dtype=np.uint8) for _ in range(2))
    pair = both_ways(first, second)
    assert pair.forward.shape == (*size, 2) and np.isfinite(pair.forward).all() and np.isfinite(pair.backward).all()
    assert pair.confidence.shape == size and pair.confidence.dtype == np.uint8


def test_flow_does_not_depend_on_threads():
    first, second = pattern(seed=1), np.roll(pattern(seed=1), 2, 0)
    threads = cv2.getNumThreads()
    results = []
    try:
        for count in (1, 2, 4):
            cv2.setNumThreads(count)
            results.append(dis_flow(first, second))
    finally:
        cv2.setNumThreads(threads)
    assert all(np.array_equal(results[0], other) for other in results[1:])


def test_pictures_of_other_types_and_sizes_are_refused():
    with pytest.raises(ValueError, match=r"picture: expected uint8 \[H, W, 3\]"):
        dis_flow(np.zeros((8, 8, 3)), np.zeros((8, 8, 3)))
    with pytest.raises(ValueError, match="differ in size"):
        dis_flow(np.zeros((8, 8, 3), np.uint8), np.zeros((8, 9, 3), np.uint8))


def test_end_point_error_on_rubberwhale():
    folder = SHARED / "flow" / "rubberwhale"
    if not folder.is_dir():
        pytest.skip("needs ../shared/flow/rubberwhale, which is not part of the repository")
    first, second = (cv2.cvtColor(cv2.imread(str(folder / f"RubberWhale{k}.png")), cv2.COLOR_BGR2RGB) for k in (1, 2))
    data = (folder / "RubberWhale.flo").read_bytes()
    width, height = np.frombuffer(data[4:12], np.int32)
    truth = np.frombuffer(data[12:], np.float32).reshape(height, width, 2)
    known = (np.abs(truth) < 1e8).all(-1)
    pair = both_ways(first, second)
    error = np.linalg.norm(pair.forward - truth, axis=-1)
    assert error[known].mean() < 0.235  # OpenCV's DIS is known to reach 0.224
    trusted = known & (pair.confidence == 255)
    assert trusted.mean() > 0.7 and error[trusted].mean() < 0.95 * error[known].mean()


@pytest.fixture(scope="module")
def slow_capture(tmp_path_factory):
    """Two fixed cameras x 8 times, 160x128; objects move about 3 px from one time to the next."""
    options = Options(backdrop="room", rig="arc", cameras=2, times=8, motion=0.3, width=160, height=128, samples=2, fov_degrees=60.0)
    return write_n3v(make(options), tmp_path_factory.mktemp("slow"))


def test_flow_of_a_fixed_rig_agrees_with_exact_flow(slow_capture, tmp_path):
    flow, frames = run(slow_capture.root, tmp_path)
    pairs = flow.read("pair")
    assert len(pairs) == 7 and pairs.dtype == np.int32  # one training camera, 8 times
    assert (frames.split[pairs] == 0).all() and (frames.camera[pairs[:, 0]] == frames.camera[pairs[:, 1]]).all()
    assert (frames.next[pairs[:, 0]] == pairs[:, 1]).all()
    errors, unmoved = [], []
    scene = slow_capture.synthetic.scene
    forward, confidence = flow.read("forward").astype(float), flow.read("confidence")
    for p, (i, j) in enumerate(pairs):
        view = next(v for v in slow_capture.views if v.camera_index == frames.camera[i] and abs(v.time - frames.time[i]) < 1e-6)
        truth = optical_flow(scene, view.camera, frames.time[i], frames.time[j])
        moving = truth.visible & (confidence[p] == 255) & (np.linalg.norm(truth.flow, axis=-1) > 0.5)
        errors.append(np.linalg.norm(forward[p] - truth.flow, axis=-1)[moving])
        unmoved.append(np.linalg.norm(truth.flow, axis=-1)[moving])
    assert np.concatenate(errors).size > 300
    assert np.concatenate(errors).mean() < 0.35 * np.concatenate(unmoved).mean()
    assert flow.array("forward").dtype == np.float16 and flow.attrs["method"] == "dis-medium"


def test_edges_cover_training_frames_only(n3v_capture, tmp_path):
    flow, frames = run(n3v_capture.root, tmp_path, max_pairs=2)
    edges = flow.read("edges")
    paired = {int(i) for i in flow.read("pair").ravel()}
    alone = next(int(i) for i in frames.train if int(i) not in paired)
    assert np.array_equal(edges[alone], edge_weights(frames.composited(alone)))
    assert all(edges[i].max() > 128 for i in paired)
    assert edges[frames.split == 2].max() == 0
    assert flow.array("forward").shape == (2, frames.height, frames.width, 2)


def test_what_does_not_change_is_not_measured(tmp_path, monkeypatch):
    """Two static frames between moving ones: their flow is zero, everything in it is trusted, and nobody computed it."""
    rng = np.random.default_rng(3)
    base = pattern(96, 128)
    (tmp_path / "images").mkdir()
    for k, shift in enumerate((0, 3, 3, 6)):
        image = np.clip(np.roll(base, shift, 1).astype(float) + rng.normal(0, 1, base.shape), 0, 255).astype(np.uint8)
        cv2.imwrite(str(tmp_path / "images" / f"{k:03d}.png"), image)
    measured = []
    original = Dis._flow
    monkeypatch.setattr(Dis, "_flow", lambda self, a, b: measured.append(1) or original(self, a, b))
    flow, _ = run(tmp_path / "images", tmp_path / "out", holdout=0)
    assert len(flow.read("pair")) == 3 and flow.attrs["static_pairs"] == 1 and len(measured) == 4
    assert not flow.read("forward")[1].any() and not flow.read("backward")[1].any() and (flow.read("confidence")[1] == 255).all()
    assert np.abs(np.median(flow.read("forward")[[0, 2]], axis=(1, 2)) - [3, 0]).max() < 0.1


def test_a_capture_in_which_nothing_moves_is_told_by_itself(tmp_path):
    """Two fixed cameras that see noise alone; then something passes one of them."""

    def capture(passes: bool) -> Path:
        options = Options(backdrop="room", rig="arc", cameras=3, times=5, motion=0.5 if passes else 0.0, width=96, height=72, samples=1)
        return write_n3v(make(options), tmp_path / f"capture{passes}").root

    static, _ = run(capture(False), tmp_path / "static", detect_static=True)
    assert static.attrs["static"] and "no pixel of 2 fixed cameras changes" in static.attrs["static_reason"]
    assert static.read("pair").shape == (0, 2) and "forward" not in static and "ever_moving" not in static
    assert measured_flow(static, None) is None
    moving, _ = run(capture(True), tmp_path / "moving", detect_static=True)
    assert not moving.attrs["static"] and moving.attrs["largest_moving_share"] > 0 and len(moving.read("pair")) > 0


def test_raft_runs_where_weights_are_given_and_says_so(nerfstudio_capture, tmp_path):
    weights = tmp_path / "raft.safetensors"
    save_file(random_state(SMALL), weights)
    settings, threads = {"weights": weights, "iterations": 2, "max_pairs": 3}, torch.get_num_threads()
    flow, frames = run(nerfstudio_capture.root, tmp_path / "a", **settings)
    assert flow.attrs["method"] == "raft-small" and flow.array("forward").shape == (3, frames.height, frames.width, 2)
    assert torch.get_num_threads() == threads, "RAFT's threads are its own affair"
    again, _ = run(nerfstudio_capture.root, tmp_path / "b", **settings)
    assert np.array_equal(flow.read("forward"), again.read("forward"))
    facts = {**BASE, "pairs": 3}
    assert "weights of raft.safetensors" in Flow().applies(facts, FlowSettings(weights=weights)).reason
    assert "OpenCV's DIS: RAFT, which is more accurate, needs weights" in Flow().applies(facts, FlowSettings()).reason


def test_weights_that_do_not_fit_stop_the_stage_with_advice(nerfstudio_capture, tmp_path, monkeypatch):
    weights = tmp_path / "raft.safetensors"
    save_file(random_state(SMALL), weights)
    with pytest.raises(StageError, match=r"holds raft-small, but flow.method is raft"):
        run(nerfstudio_capture.root, tmp_path / "a", method="raft", weights=weights)
    weights.write_bytes(weights.read_bytes()[:1000])
    with pytest.raises(StageError, match=r"flow.weights: .*raft.safetensors: cannot be read"):
        run(nerfstudio_capture.root, tmp_path / "b", weights=weights)
    monkeypatch.setitem(sys.modules, "torchvision.models", None)
    with pytest.raises(StageError, match=r"torchvision cannot be imported .*flow.method=dis"):
        run(nerfstudio_capture.root, tmp_path / "c", method="raft")


def test_torchvisions_weights_serve_where_no_file_is_given(nerfstudio_capture, tmp_path, monkeypatch):
    """Its own loader is stood in for: it fetches from the network."""
    state = {torchvisions(name, True): value for name, value in random_state(SMALL).items()}
    default = SimpleNamespace(get_state_dict=lambda progress, check_hash: state if check_hash else None)
    published = SimpleNamespace(Raft_Small_Weights=SimpleNamespace(DEFAULT=default))
    monkeypatch.setitem(sys.modules, "torchvision.models", SimpleNamespace(optical_flow=published))
    flow, _ = run(nerfstudio_capture.root, tmp_path, method="raft-small", iterations=1, max_pairs=1)
    assert flow.attrs["method"] == "raft-small"


def test_moving_pixels_of_fixed_cameras_are_found(n3v_capture, tmp_path):
    flow, frames = run(n3v_capture.root, tmp_path, grow=2)
    cameras = flow.attrs["ever_moving_cameras"]
    assert cameras == sorted({int(c) for c in frames.camera[frames.train]})
    scene = n3v_capture.synthetic.scene
    found = missed = false = static = 0
    for mask, camera in zip(flow.read("ever_moving"), cameras):
        views = [v for v in n3v_capture.views if v.camera_index == camera]
        changes = np.ptp([render(scene, v.camera, v.time).image for v in views], axis=0).max(-1)
        found += int(((changes > 0.25) & (mask > 0)).sum())
        missed += int(((changes > 0.25) & (mask == 0)).sum())
        false += int(((cv2.dilate(changes, np.ones((13, 13))) < 0.02) & (mask > 0)).sum())
        static += int((cv2.dilate(changes, np.ones((13, 13))) < 0.02).sum())
    assert found > 500 and missed < 0.03 * found
    assert static > 1000 and false < 0.02 * static


def test_a_moving_camera_has_no_mask_and_no_memory_of_held_out_frames(nerfstudio_capture, tmp_path):
    flow, frames = run(nerfstudio_capture.root, tmp_path)
    assert "ever_moving" not in flow
    assert not np.isin(flow.read("pair"), np.flatnonzero(frames.split != 0)).any()
    assert len(flow.read("pair")) > 3


def test_frames_have_masks_of_what_moves_but_held_out_ones(nerfstudio_capture, tmp_path):
    flow, frames = run(nerfstudio_capture.root, tmp_path)
    masks, held_out = flow.read("moving"), np.setdiff1d(np.arange(len(frames)), frames.train)
    assert masks.shape == (len(frames), frames.height, frames.width) and len(held_out)
    assert not masks[held_out].any()
    assert flow.attrs["moving_share"] == pytest.approx((masks[frames.train] > 0).mean(), abs=1e-6)


def test_masks_of_moving_pixels_can_be_left_out(nerfstudio_capture, tmp_path):
    flow, _ = run(nerfstudio_capture.root, tmp_path, moving=False)
    assert "moving" not in flow and "moving_share" not in flow.attrs


def frameset(camera, time, nxt, train) -> SimpleNamespace:
    return SimpleNamespace(camera=np.array(camera), time=np.array(time), next=np.array(nxt), train=np.array(train))


def test_pairs_are_thinned_evenly_and_skip_held_out_frames():
    frames = frameset([0] * 10, np.linspace(0, 1, 10), [*range(1, 10), -1], [0, 1, 2, 3, 5, 6, 7, 8, 9])
    assert choose_pairs(frames, 100) == [0, 1, 2, 5, 6, 7, 8]
    assert choose_pairs(frames, 3) == [0, 2, 6]
    assert choose_pairs(frames, 0) == []


@pytest.mark.parametrize(("cameras", "pairs"), [(1, 600), (2, 400)])
def test_one_camera_keeps_more_pairs_than_a_rig(cameras, pairs):
    count = 700
    camera = np.repeat(np.arange(cameras), count // cameras)
    last = np.append(np.diff(camera) > 0, True)
    frames = frameset(camera, np.tile(np.linspace(0, 1, count // cameras), cameras), np.where(last, -1, np.arange(count) + 1), range(count))
    assert len(choose_pairs(frames, None)) == pairs
    assert len(choose_pairs(frames, 650)) == 650


def test_one_frame_has_no_pair():
    assert choose_pairs(frameset([0], [0.0], [-1], [0]), 10) == []


def clip(noise: float, gain: float, times: int = 12) -> list[np.ndarray]:
    rng = np.random.default_rng(7)
    frames = []
    for k in range(times):
        frame = pattern(80, 100, seed=3).astype(float) * 0.6 + 40
        frame[30:42, 10 + 5 * k : 22 + 5 * k] = (220, 40, 40)
        frame = frame + gain * (k % 3) + rng.normal(0, noise, frame.shape)
        frames.append(np.clip(frame, 0, 255).astype(np.uint8))
    return frames


@pytest.mark.parametrize(("noise", "gain"), [(0.0, 0.0), (3.0, 0.0), (2.0, 4.0)])
def test_motion_mask_ignores_noise_and_flicker_and_finds_what_passes_once(noise, gain):
    frames = clip(noise, gain)
    mask = motion_mask(lambda i: frames[i], range(len(frames)), grow=3)
    swept = np.zeros(mask.shape, bool)
    swept[30:42, 10:77] = True
    outside = cv2.dilate(swept.astype(np.uint8), np.ones((17, 17), np.uint8)) == 0
    assert (mask[swept] == 255).mean() > 0.98
    assert (mask[outside] == 0).all()


def test_motion_mask_of_a_static_scene_or_a_single_frame_is_empty():
    static = [pattern(8, 8, seed=2)] * 5
    assert not motion_mask(lambda i: static[i], range(5)).any()
    assert not motion_mask(lambda i: static[i], [0]).any()
    with pytest.raises(ValueError, match="at least one frame"):
        MotionMask([])


@pytest.mark.parametrize(("motion", "followed"), [(1.0, True), (10.0, False)])
def test_it_says_when_what_moves_goes_too_far_to_be_followed(motion, followed, tmp_path, monkeypatch):
    options = Options(backdrop="room", rig="path", times=10, width=160, height=128, samples=2, fov_degrees=60.0, motion=motion)
    frames = run_frames(write_nerfstudio(make(options), tmp_path / "capture").root, tmp_path)

    def warnings(place: str) -> tuple[list[str], Artifact]:
        inputs = {"frames": frames.artifact, "poses": None}
        ran = run_stage(Flow(), frames.context.capture, tmp_path / place, FlowSettings(detect_static=False), inputs)
        return [line for line in ran.lines if "too far" in line], ran.artifact

    said, flow = warnings("first")
    agrees, masks = flow.read("confidence") > 0, flow.read("moving") > 0
    share = np.median([agrees[p][masks[i]].mean() for p, (i, _) in enumerate(flow.read("pair")) if masks[i].any()])
    assert not said if followed else f"{100 * share:.0f} % of their pixels" in said[0]
    monkeypatch.setattr("e4dgs.stages.flow.measure.FOLLOWED", share)
    assert not warnings("at the threshold")[0]
    monkeypatch.setattr("e4dgs.stages.flow.measure.FOLLOWED", np.nextafter(share, 1))
    assert warnings("above it")[0]


@pytest.mark.parametrize(("detect_static", "above", "static"), [(True, False, False), (True, True, True), (False, True, False)])
def test_where_flow_fails_masks_are_no_sign_of_motion(detect_static, above, static, tmp_path, monkeypatch):
    options = Options(backdrop="room", rig="path", times=10, width=160, height=128, samples=2, fov_degrees=60.0, motion=10.0)
    frames = run_frames(write_nerfstudio(make(options), tmp_path / "capture").root, tmp_path)
    settings, inputs = FlowSettings(detect_static=detect_static), {"frames": frames.artifact, "poses": None}
    monkeypatch.setattr("e4dgs.stages.flow.measure.FAILED", 0.0)
    flow = run_stage(Flow(), frames.context.capture, tmp_path / "first", settings, inputs).artifact
    agrees, masks = flow.read("confidence") > 0, flow.read("moving") > 0
    share = np.median([agrees[p][masks[i]].mean() for p, (i, _) in enumerate(flow.read("pair")) if masks[i].any()])
    monkeypatch.setattr("e4dgs.stages.flow.measure.FAILED", np.nextafter(share, 1) if above else share)
    ran = run_stage(Flow(), frames.context.capture, tmp_path / "again", settings, inputs)
    found = StoredFlow(ran.artifact)
    assert found.static is static and (ran.artifact.read("moving").any() and ran.artifact.attrs["moving_share"] > 0) is not static
    assert any("as far as can be told" in line for line in ran.lines) is static
