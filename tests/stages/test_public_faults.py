"""Inputs that public bug reports describe, made by the generators in ../shared/faults: each is read right, or refused with the true reason.

The kinds are tested one by one, without these generators, in the tests of the readers.
"""

import runpy
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from e4dgs.pipeline import CaptureError
from e4dgs.stages.captures import Capture, recognise
from e4dgs.stages.shared.frameset import FrameSet
from run_stage import run_frames

FAULTS = Path(__file__).resolve().parents[2].parent / "shared" / "faults"
pytestmark = pytest.mark.skipif(not FAULTS.is_dir(), reason="../shared/faults, which makes the inputs, is not here")


@dataclass(frozen=True)
class Fault:
    """command: the generator's words, OUT for its output. check: what must hold of the capture. notes: parts of lines that people are told.
    error: the message of the refusal, if it must be refused."""

    command: str
    check: Callable[[Capture], bool] = lambda capture: True
    notes: tuple[str, ...] = ()
    error: str | None = None


def size(capture):
    return capture.facts["width"], capture.facts["height"]


def splits(capture):
    return [(name, int(split)) for name, split in zip(capture.names, capture.split)]


FAULTS_OF_CAPTURES = {
    "tiff, quarter turn": Fault("more.py tiff OUT", lambda c: size(c) == (160, 120) and len(c.names) == 12),
    "COLMAP text, empty line below the header": Fault("more.py blank_header OUT", lambda c: len(c.names) == 12),
    "COLMAP text, byte order mark and CR LF": Fault("more.py bom OUT", lambda c: len(c.names) == 12),
    "COLMAP, the second model is larger": Fault("more.py models OUT", lambda c: len(c.names) == 9, ("sparse/0",)),
    "COLMAP model in nerfstudio's place": Fault("more.py model_elsewhere OUT", lambda c: c.facts["poses"] and len(c.names) == 12),
    "LLFF": Fault("more.py llff OUT", lambda c: c.facts["poses"] and len(c.names) == 12),
    "COLMAP, a deleted picture": Fault("more.py missing OUT", lambda c: len(c.names) == 11, ("004",)),
    "8 HEIC beside 4 JPG": Fault("more.py heic OUT", lambda c: len(c.names) == 4, ("8 HEIC",)),
    "a video with a poster": Fault("more.py beside OUT", lambda c: c.facts["format"] == "video", ("2 pictures",)),
    "colour and depth in one folder": Fault("more.py depth OUT", lambda c: len(c.names) == 8, ("depth",)),
    "a list of test pictures alone": Fault(
        "more.py test_list OUT", lambda c: sorted(int(n[-7:-4]) for n, split in splits(c) if split == 2) == [1, 5, 11]
    ),
    "frames in none of the lists": Fault("more.py some_lists OUT", lambda c: len(c.names) == 10, ("2 ",)),
    "FULL_OPENCV": Fault("more.py full_opencv OUT", lambda c: c.distortion is not None and c.distortion.shape[1] == 8),
    "absolute paths into the capture": Fault("more.py absolute OUT", lambda c: len(c.names) == 12),
    "two focal lengths": Fault("more.py two_focals OUT", error="(?s)fl_x.*camera_angle_x"),
    "intrinsics of larger pictures": Fault("more.py far_centre OUT", notes=("principal point",)),
    "AVI with gaps": Fault("more.py avi OUT.avi", lambda c: len(c.names) == 16),
    "interlaced": Fault("more.py interlaced OUT.mp4", notes=("interlaced",)),
    "pixels 4:3 as wide as high": Fault("anamorphic.py OUT.mp4", lambda c: size(c) == (480, 360), ("pixels are 4:3",)),
    "a cover as the first stream": Fault("cover_first.py OUT.mp4", lambda c: size(c) == (160, 120) and len(c.names) == 16),
    "an edit list, both ends": Fault("edit_list.py OUT.mp4 20 30", lambda c: len(c.names) in (10, 11)),  # its end is rounded up by 0.3 ms
    "an edit list, first groups": Fault("edit_list.py OUT.mp4 20 48", lambda c: len(c.names) == 28),
    "an edit list, last group": Fault("edit_list.py OUT.mp4 36 48", lambda c: len(c.names) == 12),
    "an edit list, the tail": Fault("edit_list.py OUT.mp4 0 30", lambda c: len(c.names) == 30),
}


def made(command: str, folder: Path) -> Path:
    """Runs a generator; returns its output."""
    words = command.replace("OUT", str(folder / "out")).split()
    generate(*words)
    return Path(next(word for word in words if word.startswith(str(folder))))


def generate(script: str, *words: str) -> None:
    """In this process, which has what a generator imports; a new one would take longer to import it than to write the capture."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", [script, *words])
        patch.setattr(sys, "path", [str(FAULTS), *sys.path])
        patch.chdir(FAULTS)
        runpy.run_path(str(FAULTS / script), run_name="__main__")


@pytest.mark.parametrize("name", FAULTS_OF_CAPTURES)
def test_is_read_right_or_refused_truly(name, tmp_path):
    fault = FAULTS_OF_CAPTURES[name]
    path = made(fault.command, tmp_path)
    if fault.error is not None:
        with pytest.raises(CaptureError, match=fault.error):
            recognise(path)
        return
    capture = recognise(path)
    assert fault.check(capture)
    for part in fault.notes:
        assert any(part in note for note in capture.notes), capture.notes


def frames_of(path: Path, folder: Path) -> FrameSet:
    ran = run_frames(path, folder)
    return FrameSet(ran.artifact, ran.context.capture.root)


@pytest.mark.parametrize("transfer", ["hlg", "pq"])
def test_hdr_comes_out_as_it_was_filmed(transfer, tmp_path):
    path = made(f"hdr_hlg.py OUT.mov {transfer}", tmp_path)
    frames, truth = frames_of(path, tmp_path / "work"), np.load(f"{path}.sdr.npy")
    error = np.stack([frames.image(i).astype(float) - truth[i] for i in range(len(truth))])
    assert np.abs(error).mean() < 6.0 and np.abs(error.mean((0, 1, 2))).max() < 4.0
    red = (truth == (220, 40, 40)).all(-1)
    assert np.abs(np.stack([frames.image(i) for i in range(len(truth))])[red].mean(0) - (220, 40, 40)).max() < 10


def test_a_doubled_time_stamp_costs_only_its_own_time(tmp_path):
    path = made("double_timestamp.py OUT.mkv", tmp_path)
    capture, truth = recognise(path), np.load(f"{path}.npy")
    wrong = np.abs(capture.seconds - (truth - truth[0])) > 1e-3
    assert wrong.sum() <= 1 and np.abs(capture.seconds - (truth - truth[0])).max() < 0.04
    assert any("time stamp" in note for note in capture.notes)


def test_two_videos_one_with_a_doubled_stamp_share_all_times(tmp_path):
    folder = tmp_path / "both"
    folder.mkdir()
    for name, clean in (("a.mkv", ""), ("b.mkv", "clean")):
        generate("double_timestamp.py", str(folder / name), *clean.split())
    for truth in folder.glob("*.npy"):
        truth.unlink()
    assert recognise(folder).facts["times"] >= 59


def test_rows_of_poses_are_matched_in_plain_order(tmp_path):
    path = made("more.py unpadded OUT", tmp_path)
    capture = recognise(path)
    assert capture.cam_from_world is not None
    centres = {n.split(".")[0]: -m[:3, :3].T @ m[:3, 3] for n, m in zip(capture.names, capture.cam_from_world)}
    x = [centres[f"cam{k + 1}"][0] for k in range(12)]
    assert (np.diff(x) > 0).all(), "cam1 to cam12 stand from left to right"
    assert any("plain order" in note for note in capture.notes)
    assert {n.split(".")[0] for n, split in splits(capture) if split == 2} == {"cam1"}


def test_tiffs_of_a_model_keep_the_pixels_that_its_poses_belong_to(tmp_path):
    path = made("more.py tiff_colmap OUT", tmp_path)
    sys.path.insert(0, str(FAULTS))
    try:
        import common
    finally:
        sys.path.remove(str(FAULTS))
    frames = frames_of(path, tmp_path / "work")
    assert np.abs(frames.image(3).astype(int) - common.picture(3, 12)[0]).mean() < 1.0


def test_a_zip_of_powershell_is_the_capture_in_it(tmp_path):
    from e4dgs.workflows.storage.archive import unpacked

    path = made("powershell_zip.py OUT.zip", tmp_path)
    capture = recognise(unpacked(path, tmp_path / "ws"))
    assert capture.facts["format"] == "colmap" and capture.facts["poses"] and len(capture.names) == 12
