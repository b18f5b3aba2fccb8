"""Exports of times at which nothing is visible: all Gaussians are outside their lifetimes."""

import json
import math
import sys
from pathlib import Path

import pytest
import torch
from e4dgs.pipeline import StageError
from e4dgs.stages.exports.splats import KINDS, export_splats
from e4dgs.stages.exports.straight.export import export_straight
from e4dgs.stages.exports.usd import export_usd
from e4dgs.stages.shared.posed_frameset import PosedFrameSet
from made_models import FRAMES, made
from run_stage import run_frames

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "benchmarks"))

import export_readers as readers

SEEN = 2 / (FRAMES - 1)  # the only time of the capture at which something is there


@pytest.fixture(scope="module")
def frames(dnerf_capture, tmp_path_factory) -> PosedFrameSet:
    return PosedFrameSet(run_frames(dnerf_capture.root, tmp_path_factory.mktemp("empty")).artifact, dnerf_capture.root)


@pytest.fixture
def model():
    found = made("lives", gaussians=40, convexes=0, antialiased=False)
    found.gaussians.dynamic[:] = True
    with torch.no_grad():
        found.gaussians.times[:] = 2.0
        found.gaussians.log_spans[:] = math.log(0.3)
    return found


@pytest.mark.parametrize("kind", KINDS)
def test_a_sequence_with_an_empty_time_is_whole_and_says_so(kind, model, frames, tmp_path):
    done = export_splats(model, frames, tmp_path / "out", [0.0, SEEN, 1.0], kind)
    index = json.loads((tmp_path / "out" / "sequence.json").read_text())[KINDS[kind]]
    assert [row["file"] for row in index["files"]] == [f"frame000{k}{KINDS[kind]}" for k in (1, 2, 3)] and (done.fewest, done.most) == (
        0,
        40,
    )
    (said,) = (note for note in done.notes if "nothing is visible" in note)
    assert said.startswith(f"nothing is visible at 2 of 3 times, first at time 0 (frame0001{KINDS[kind]})")


@pytest.mark.parametrize("kind", KINDS)
def test_an_export_of_nothing_is_an_error_that_says_which_time(kind, model, frames, tmp_path):
    with pytest.raises(StageError, match=r"nothing is visible at time 1; .*--time"):
        export_splats(model, frames, tmp_path / f"one{KINDS[kind]}", [1.0], kind, single=True)
    with pytest.raises(StageError, match="nothing is visible at any of 2 times"):
        export_splats(model, frames, tmp_path / "out", [0.0, 1.0], kind)
    assert not list(tmp_path.iterdir())


def test_usd_of_nothing_is_an_error(model, frames, tmp_path):
    pytest.importorskip("pxr")
    with pytest.raises(StageError, match="export usd: nothing is visible at any of 2 times"):
        export_usd(model, frames, tmp_path / "a.usdc", [0.0, 1.0], FRAMES)
    assert not list(tmp_path.iterdir()) and export_usd(model, frames, tmp_path / "a.usdc", [0.0, SEEN], FRAMES).gaussians == 40


@pytest.mark.parametrize("kind", ["4dgs", "freetime"])
def test_one_file_of_a_clip_may_have_empty_times_but_not_only_these(kind, model, frames, tmp_path):
    pytest.importorskip("fourdgs")
    assert export_straight(model, frames, tmp_path / "a", FRAMES, kind).psnr > 25
    with pytest.raises(StageError, match="nothing is visible at time 1"):
        export_straight(model, frames, tmp_path / "b", FRAMES, kind, moment=1.0)
    assert [one.name for one in tmp_path.iterdir()] == ["a"]


def test_splat_transform_reads_a_sog_file_that_shows_nothing(model, frames, tmp_path):
    transform = readers.splat_transform() or pytest.skip("needs splat-transform: npm install @playcanvas/splat-transform, and E4DGS_NPM")
    export_splats(model, frames, tmp_path, [0.0, SEEN], "sog")
    read = readers.by_splat_transform(transform, tmp_path / "frame0001.sog")
    assert len(read.means) == 1 and float(read.opacities.max()) < 1e-3
