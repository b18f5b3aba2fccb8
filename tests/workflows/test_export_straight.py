"""`e4dgs export 4dgs` and `export ply --freetime`: one file for the whole clip, its size and its loss said."""

import builtins
import re
from types import SimpleNamespace

import pytest
import tiny_run
from e4dgs.scene.formats.freetime import read_freetime
from e4dgs.workflows.cli import main
from e4dgs.workflows.exports.trained import Trained

pytestmark = pytest.mark.usefixtures("short_fit")


@pytest.fixture(scope="module")
def words(finished_run):
    capture, workspace = finished_run
    return [str(capture.root), "--workspace", str(workspace), *tiny_run.QUICK]


def test_one_4dgs_file_holds_the_clip(words, tmp_path, capsys):
    fourdgs = pytest.importorskip("fourdgs")
    out = tmp_path / "scene.4dgs"
    assert main(["export", "4dgs", *words, "--out", str(out)]) == 0
    said = " ".join(capsys.readouterr().out.split())
    found = re.search(r"Gaussians in (\d+) straight pieces; ([\d.]+) MB.* ([\d.]+) dB from the model's Gaussians when decoded", said)
    # How close it is to models of every motion is for tests/stages/test_pieces.py; this one has hardly been trained.
    assert found and float(found[3]) >= 25 and "convexes became Gaussians" in said and "axes: up is Y" in said
    scene = fourdgs.read(out)
    assert scene.gaussians.count == int(found[1]) and scene.duration_sec > 0
    still = tmp_path / "still.4dgs"
    assert main(["export", "4dgs", *words, "--time", "0.3", "--up", "Z", "--out", str(still)]) == 0
    assert still.stat().st_size < out.stat().st_size and fourdgs.read(still).provenance.frames[0].up_axis == 2


def test_one_freetime_file_holds_the_clip(words, tmp_path, capsys):
    out = tmp_path / "scene.ply"
    assert main(["export", "ply", *words, "--freetime", "--out", str(out)]) == 0
    assert "dB from the model's Gaussians when decoded" in capsys.readouterr().out
    assert len(read_freetime(out.read_bytes())) > 0 and [one.name for one in tmp_path.iterdir()] == ["scene.ply"]


@pytest.mark.parametrize(
    ("command", "options", "said"),
    [
        ("4dgs", ("--times", "3"), "--times: one file holds the whole clip"),
        ("4dgs", ("--out", "a.ply"), "the file must end in .4dgs"),
        ("4dgs", ("--time", "2"), "--time 2"),
        ("web", ("--up", "Z"), "--up: the page turns the scene itself"),
        ("web", ("--antialiased",), "--antialiased: the page draws the model as it was trained"),
        ("mesh", ("--antialiased",), "--antialiased: triangles have no opacity"),
        ("flow", ("--time", "0.5"), "--time: every pair of frames is written"),
        ("ply", ("--freetime", "--times", "3"), "--freetime and --times"),
        ("ply", ("--freetime", "--compressed"), "--freetime and --compressed"),
    ],
)
def test_what_means_nothing_is_refused_with_the_reason(words, capsys, tmp_path, monkeypatch, command, options, said):
    monkeypatch.chdir(tmp_path)
    assert main(["export", command, *words, *options]) == 2
    assert said in " ".join(capsys.readouterr().err.split()) and not list(tmp_path.iterdir())


def test_without_the_package_one_line_says_how_to_get_it(words, tmp_path, capsys, monkeypatch):
    usual = builtins.__import__

    def lacking(name, *arguments, **more):
        if name == "fourdgs":
            raise ImportError(name)
        return usual(name, *arguments, **more)

    monkeypatch.setattr(builtins, "__import__", lacking)
    assert main(["export", "4dgs", *words, "--out", str(tmp_path / "a.4dgs")]) == 2
    assert "pip install 'e4dgs[fourdgs]'" in " ".join(capsys.readouterr().err.split()) and not list(tmp_path.iterdir())


def test_more_times_than_a_scene_has_that_stands_still_are_told(capsys):
    still = Trained(None, SimpleNamespace(motion=SimpleNamespace(static=True)), None)
    assert still.moments(30) == 1
    assert capsys.readouterr().out == "nothing moves in this scene, so --times 30 makes one file\n"
    assert still.moments(1) == still.moments(None) == 1 and capsys.readouterr().out == ""
