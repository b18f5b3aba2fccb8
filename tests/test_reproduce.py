"""docs/reproduce.md: captures in the layouts of public data sets are read with the splits of the published tables.

`tests/test_run_printed_commands.py` runs the page's commands on these captures.
"""

from pathlib import Path

import numpy as np
import public_captures as public
import pytest
from e4dgs.stages.captures import recognise
from e4dgs.stages.shared.frameset import FrameSet
from run_stage import run_frames
from script_module import load_script

ROOT = Path(__file__).resolve().parents[1]
splits = load_script(ROOT / "benchmarks" / "published_splits.py")


def held_out(capture) -> list[str]:
    return [name for name, split in zip(capture.names, capture.split) if split != 0]


def test_coffee_martini_loses_cam13_and_its_row_of_poses(tmp_path):
    public.coffee_martini(tmp_path / "all")
    splits.without(tmp_path / "all", "cam13", tmp_path / "scene")
    before, after = recognise(tmp_path / "all"), recognise(tmp_path / "scene")
    assert after.facts["splits"] == {"train": 12, "val": 0, "test": 6} and all(name.startswith("cam00") for name in held_out(after))
    kept = [i for i, name in enumerate(before.names) if not name.startswith("cam13")]
    assert list(after.names) == [before.names[i] for i in kept]
    np.testing.assert_array_equal(after.cam_from_world, before.cam_from_world[kept])
    with pytest.raises(SystemExit, match="there is no cam77"):
        splits.without(tmp_path / "all", "cam77", tmp_path / "other")


def test_videos_are_halved_by_area(tmp_path):
    public.coffee_martini(tmp_path)
    ran = run_frames(tmp_path, tmp_path / "workspace", max_size=40)
    frames = FrameSet(ran.artifact, tmp_path)
    assert (frames.width, frames.height) == (40, 32)


def test_the_rig_of_hypernerf_takes_turns(tmp_path):
    public.vrig(tmp_path)
    capture = recognise(tmp_path)
    assert capture.facts["splits"] == {"train": 6, "val": 6, "test": 0}
    for time in np.unique(capture.time):
        now = capture.time == time
        assert sorted(capture.split[now]) == [0, 1] and len(set(capture.camera[now])) == 2
    assert {camera for camera, split in zip(capture.camera, capture.split) if split == 0} == {0, 1}


def test_metrics_of_dycheck_count_what_training_views_see(tmp_path):
    public.iphone(tmp_path)
    capture = recognise(tmp_path)
    assert capture.facts["splits"] == {"train": 6, "val": 12, "test": 0}
    assert any("12 of 12 validation views count only pixels that training views see (covisible/1x/val/)" in n for n in capture.notes)
    frames = FrameSet(run_frames(tmp_path, tmp_path / "workspace").artifact, tmp_path)
    for i, split in enumerate(frames.split):
        kept = frames.kept(i)
        assert kept is None if split == 0 else (kept[:, :40].all() and not kept[:, 40:].any())


def test_panoptic_holds_out_the_cameras_of_the_file(tmp_path):
    public.panoptic(tmp_path)
    capture = recognise(tmp_path)
    assert capture.facts["splits"] == {"train": 12, "val": 0, "test": 4} and capture.facts["fixed_cameras"]


def test_nvidia_trains_on_one_moving_camera_and_tests_the_first_at_all_times(tmp_path):
    public.nvidia(tmp_path / "scene")
    splits.nvidia(tmp_path / "scene", tmp_path / "scene" / public.TRUTH, tmp_path / "split")
    capture = recognise(tmp_path / "split")
    facts = capture.facts
    assert (facts["splits"], facts["times"], facts["cameras"]) == ({"train": 6, "val": 0, "test": 6}, 6, 2)
    assert facts["pairs"] == 5 and not any("counts as a camera of its own" in note for note in capture.notes)
    whole = recognise(tmp_path / "scene")
    train, test = capture.split == 0, capture.split == 2
    np.testing.assert_allclose(capture.cam_from_world[train], whole.cam_from_world, atol=1e-9)
    np.testing.assert_allclose(capture.cam_from_world[test], np.repeat(whole.cam_from_world[:1], 6, axis=0), atol=1e-9)
    np.testing.assert_allclose(capture.K[0] * [[2], [2], [1]], whole.K[0])
    np.testing.assert_allclose(capture.time[train], capture.time[test])
