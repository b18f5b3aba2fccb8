"""`frames.every_time`: every N-th time trains, and the same cameras at the other times are the test."""

import json
from types import SimpleNamespace

import numpy as np
import pytest
from e4dgs.pipeline import CaptureError
from e4dgs.stages.captures import recognise
from e4dgs.stages.captures.reading import TEST, TRAIN, VAL
from e4dgs.stages.evaluate.protocol import protocol
from e4dgs.stages.evaluate.settings import EvaluateSettings
from e4dgs.stages.evaluate.views import choose_views
from e4dgs.stages.shared.frameset import FrameSet
from factory import Options, make, write_dnerf
from run_stage import run_frames


def ranks(capture):
    """The number of each frame's time, from 0."""
    return np.unique(np.round(capture.time, 9), return_inverse=True)[1]


def test_a_rig_trains_on_all_cameras_of_every_second_time(n3v_capture):
    """Four cameras, six times. Camera 0, which the files hold out, is val: new views apart from new times."""
    capture = recognise(n3v_capture.root, every_time=2)
    rank, own = ranks(capture), capture.camera == 0
    np.testing.assert_array_equal(capture.split, np.where(own, VAL, np.where(rank % 2, TEST, TRAIN)))
    assert capture.facts["splits"] == {"train": 9, "val": 6, "test": 9} and capture.facts["every_time"] == 2
    for i, following in enumerate(capture.next):
        if capture.split[i] != TRAIN or rank[i] == 4:
            assert following == -1, "what is held out, and the last time, has no next frame"
        else:
            assert (capture.camera[following], rank[following], capture.split[following]) == (capture.camera[i], rank[i] + 2, TRAIN)
    assert capture.facts["pairs"] == 6
    assert "trains on 3 of 6 times; 9 pictures of the other times are test, and the 6 that the files hold out are val" in capture.notes[-1]


def test_several_videos_without_poses_hold_out_nothing_else(videos_capture):
    capture = recognise(videos_capture.root, every_time=3)
    np.testing.assert_array_equal(capture.split, np.where(ranks(capture) % 3, TEST, TRAIN))


@pytest.mark.parametrize("name", ["video_capture", "images_capture"])
def test_every_second_frame_of_one_camera_trains(request, name):
    """No matter what `holdout` says, which would hold out the first frame."""
    capture = recognise(request.getfixturevalue(name).root, every_time=2)
    frames = len(capture.names)
    np.testing.assert_array_equal(capture.split, [TEST if i % 2 else TRAIN for i in range(frames)])
    np.testing.assert_array_equal(capture.next, [-1 if i % 2 or i + 2 >= frames else i + 2 for i in range(frames)])
    assert capture.facts["splits"]["val"] == 0


def path_capture(folder, frames=16):
    """The layout of D-NeRF with one hand-held camera that trains, and the last two of its frames held out by the files."""
    root = write_dnerf(make(Options(rig="path", times=frames + 2, width=48, height=36, samples=1)), folder).root
    data = json.loads((root / "transforms_train.json").read_text())
    data["frames"].sort(key=lambda frame: frame["time"])
    (root / "transforms_test.json").write_text(json.dumps({**data, "frames": data["frames"][frames:]}))
    (root / "transforms_train.json").write_text(json.dumps({**data, "frames": data["frames"][:frames]}))
    return root


def test_a_path_in_the_layout_of_dnerf_trains_on_every_second_frame(tmp_path):
    root = path_capture(tmp_path / "path")
    plain, capture = recognise(root), recognise(root, every_time=2)
    assert "one smooth path" in plain.facts["why"] and "every_time" not in plain.facts
    trained = np.flatnonzero(plain.split == TRAIN)
    trained = trained[np.argsort(plain.time[trained])]
    assert (capture.split[trained] == np.resize([TRAIN, TEST], len(trained))).all()
    assert (plain.split == TEST).sum() == 2 and (capture.split[plain.split == TEST] == VAL).all()
    assert capture.next[trained[0]] == trained[2]


def test_a_cut_at_a_skipped_frame_is_not_bridged(tmp_path):
    """The camera jumps between the second frame, which is test, and the third."""
    root = path_capture(tmp_path / "cut")
    file = root / "transforms_train.json"
    data = json.loads(file.read_text())
    for frame in data["frames"][2:]:
        frame["transform_matrix"][0][3] += 30.0
    file.write_text(json.dumps(data))
    capture = recognise(root, every_time=2)
    trained = np.flatnonzero(capture.split == TRAIN)
    trained = trained[np.argsort(capture.time[trained])]
    assert capture.next[trained[0]] == -1 and capture.next[trained[1]] == trained[2]


def test_scattered_views_static_captures_and_too_few_times_are_refused(dnerf_capture, n3v_capture, nerfstudio_capture):
    with pytest.raises(CaptureError, match=r"every_time=2 needs a camera that saw several times, .* a camera of its own; leave it unset"):
        recognise(dnerf_capture.root, every_time=2)
    with pytest.raises(CaptureError, match=r"every_time=2 tests the times between those that train, and here all frames have one time"):
        recognise(nerfstudio_capture.root, static=True, every_time=2)
    with pytest.raises(CaptureError, match=r"every_time=6 would train on one of 6 times; choose at most 5"):
        recognise(n3v_capture.root, every_time=6)
    assert recognise(n3v_capture.root, every_time=5).facts["splits"]["train"] == 6


def test_the_default_changes_nothing(n3v_capture):
    capture, plain = recognise(n3v_capture.root, every_time=1), recognise(n3v_capture.root)
    assert dict(capture.facts) == dict(plain.facts) and "every_time" not in plain.facts and capture.notes == plain.notes


def test_evaluation_measures_both_apart_and_says_so(n3v_capture, tmp_path):
    ran = run_frames(n3v_capture.root, tmp_path, every_time=2)
    frames = FrameSet(ran.artifact, n3v_capture.root)
    views, _ = choose_views(frames, EvaluateSettings().splits)
    assert {split: len(found) for split, found in views.items()} == {"val": 6, "test": 9}
    assert not set(views["test"]) & set(frames.train.tolist())
    told = protocol(frames, views, EvaluateSettings(), {"lpips_reason": "none"}, [])
    assert told["split"] == "val (6 views), test (9 views)" and told["times"].startswith(
        "frames.every_time=2; test: training cameras at the times left out"
    )
    assert "times" not in protocol(
        SimpleNamespace(**{**vars(frames), "every_time": 1}), views, EvaluateSettings(), {"lpips_reason": "none"}, []
    )
