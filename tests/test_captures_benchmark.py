"""The table of benchmarks/captures.py: what a run said is kept without its progress, and a run that failed is a row, too."""

import json
from pathlib import Path

import pytest
from script_module import load_script

BENCHMARKS = Path(__file__).resolve().parents[1] / "benchmarks"
LOG = """fox: nerfstudio (transforms.json, one moving camera)
  50 frames 540x960, 1 cameras, 50 times; 43 train, 7 test
  17 of 67 frames of transforms.json have no image and are left out
stage   state  estimate      reason
frames  run    about 0.66 s  50 frames, pictures stay in their files
                             (never run for this scene)
frames: never run for this scene
  poses: matching: 384/1172 (33 %), 50 s left
  poses: 90 of 90 frames registered
  coarse: seeds: 7684 points of the capture or of SfM
error: images/003.jpg: cannot be decoded
"""


@pytest.fixture
def captures(monkeypatch):
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    return load_script(BENCHMARKS / "captures.py")


def test_what_was_said_of_the_capture_is_kept_without_progress(captures):
    assert captures.said(LOG.splitlines()) == [
        "frames: 17 of 67 frames of transforms.json have no image and are left out",
        "poses: 90 of 90 frames registered",
        "error: images/003.jpg: cannot be decoded",
    ]


def test_a_run_that_failed_is_a_row_with_its_error(captures, tmp_path):
    (tmp_path / "log").write_text(f"error: {tmp_path}/a.mp4: no | picture\n")
    row = {"exit_code": 3, "wall_seconds": 90.0, "machine": {"load": 2.5}} | captures.outcome(tmp_path)
    line = captures.table({"zip": row}).splitlines()[-1]
    assert "| 3 | 1.5 min, load 2.5 |" in line and line.endswith("| error: a.mp4: no \\| picture |")
    assert len(line.replace("\\|", "").split("|")) == len(captures.table({}).splitlines()[0].split("|"))


def test_what_was_not_measured_is_named(captures):
    assert "Not measured yet: nerfies, rotated-video" in captures.page("captures.json", {})


def test_a_capture_that_is_refused_is_measured_and_written(captures, tmp_path, monkeypatch):
    (tmp_path / "scenes" / "stage").mkdir(parents=True)
    words = [str(tmp_path / "scenes"), "--only", "stage", "fox", "--scratch", str(tmp_path / "work"), "--out", str(tmp_path / "rows.json")]
    monkeypatch.setattr("sys.argv", ["captures.py", *words])
    captures.main()
    (row,) = json.loads((tmp_path / "rows.json").read_text())["results"].values()
    assert row["exit_code"] == 2 and row["said"][0].startswith("error: ") and "| stage |" in (tmp_path / "rows.md").read_text()
