"""`e4dgs export ply` writes a file a time, and says how far the convexes' Gaussians are from them; other programs read all of it."""

import json
import re
import sys
from pathlib import Path

import numpy as np
import pytest
from e4dgs.stages.exports.splats import KINDS
from e4dgs.workflows.cli import main
from open3d_here import problem
from scipy.spatial import KDTree

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "benchmarks"))

import export_readers as readers
import exports

pytestmark = pytest.mark.usefixtures("short_fit")
QUICK = ["--set", "coarse.iterations=40", "--set", "hulls.budget=20", "--set", "fine.iterations=10", "--device", "cpu"]


@pytest.fixture(scope="module")
def finished(dnerf_capture, tmp_path_factory):
    workspace = tmp_path_factory.mktemp("ply") / "workspace"
    assert main(["run", "all", str(dnerf_capture.root), "--workspace", str(workspace), *QUICK]) == 0
    return ["ply", str(dnerf_capture.root), "--workspace", str(workspace), *QUICK]


def test_a_file_for_each_time(finished, tmp_path, capsys):
    assert main(["export", *finished, "--times", "3", "--out", str(tmp_path / "ply")]) == 0
    files = sorted((tmp_path / "ply").iterdir())
    assert [f.name for f in files] == ["frame0001.ply", "frame0002.ply", "frame0003.ply", "sequence.json"]
    index = json.loads(files.pop().read_text())[".ply"]
    assert [row["time"] for row in index["files"]] == [0.0, 0.5, 1.0] and (index["up"], index["antialiased"]) == ("-Y", False)
    assert files[0].read_bytes() != files[2].read_bytes(), "something moves"
    said = " ".join(capsys.readouterr().out.split())
    assert "axes: up is -Y, which is Z in the capture (a turn by 90° about X)" in said, "D-NeRF stands upright on z"
    found = re.search(r"(\d+) convexes became Gaussians: ([\d.]+) dB", said)
    assert found and int(found[1]) > 0 and float(found[2]) > 15


def test_an_export_of_fewer_times_leaves_none_of_the_earlier_one(finished, tmp_path):
    others = ["frame0009.ply.bak", "frame0009.spz", "mine.ply"]
    for name in others:
        (tmp_path / name).write_text("mine")
    for times in (5, 2):
        assert main(["export", *finished, "--times", str(times), "--out", str(tmp_path)]) == 0
        made = {f.name for f in tmp_path.iterdir()} - {*others, "sequence.json"}
        assert made == {f"frame000{k + 1}.ply" for k in range(times)}
    assert all((tmp_path / name).read_text() == "mine" for name in others), "only files of exactly such a name go"


def test_without_times_there_is_a_file_for_each_of_the_capture(finished, tmp_path):
    assert main(["export", *finished, "--out", str(tmp_path)]) == 0
    assert 1 < len(list(tmp_path.glob("*.ply"))) <= 60


@pytest.mark.parametrize("words", [["ply"], ["usd"], ["mesh", "--convexes"]])
def test_a_clip_that_is_thinned_is_said(finished, tmp_path, capsys, monkeypatch, words):
    if words == ["usd"]:
        pytest.importorskip("pxr")
    monkeypatch.setattr("e4dgs.workflows.exports.trained.MOST_TIMES", 3)
    assert main(["export", words[0], *finished[1:], *words[1:], "--out", str(tmp_path)]) == 0
    found = re.search(r"note: 3 of (\d+) times; --times (\d+) for all;", " ".join(capsys.readouterr().out.split()))
    assert found and int(found[1]) == int(found[2]) > 3
    assert main(["export", words[0], *finished[1:], *words[1:], "--times", "3", "--out", str(tmp_path)]) == 0
    assert "for all" not in capsys.readouterr().out, "who asks for 3 knows"


@pytest.mark.parametrize("name", ["frame0009.compressed.ply", "frame9.ply", "frame0001.ply", "frame0009.PLY"])
def test_nothing_is_mixed_with_numbered_files_of_others(finished, tmp_path, capsys, name):
    (tmp_path / name).write_text("mine")
    assert main(["export", *finished, "--out", str(tmp_path)]) == 2
    assert f"it has {name}" in " ".join(capsys.readouterr().err.split()) and [one.name for one in tmp_path.iterdir()] == [name]


# The formats for the web round positions: SPZ and SOG to 2e-4 of the scene's size, compressed PLY to 3e-3.
@pytest.mark.parametrize(
    ("words", "suffix", "tolerance"),
    [(["spz"], ".spz", 2e-4), (["sog"], ".sog", 2e-4), (["ply", "--compressed"], ".compressed.ply", 3e-3)],
)
def test_compact_formats_hold_the_same_gaussians(finished, tmp_path, words, suffix, tolerance):
    forge = pytest.importorskip("gaussforge").GaussForge()
    once = ["--times", "1", "--up", "Z"]
    assert main(["export", *finished, *once, "--out", str(tmp_path / "ply")]) == 0
    assert main(["export", words[0], *finished[1:], *words[1:], *once, "--out", str(tmp_path / "out")]) == 0
    (file,) = (tmp_path / "out").glob("frame*")
    assert file.name == f"frame0001{suffix}"
    plain = (tmp_path / "ply" / "frame0001.ply").read_bytes()
    back = forge.convert(file.read_bytes(), suffix[1:], "ply")["data"]
    ours, theirs = centres(plain), centres(bytes(back))
    assert len(ours) == len(theirs) and len(file.read_bytes()) < len(plain)
    distance, _ = KDTree(theirs).query(ours)
    assert distance.max() <= tolerance * np.ptp(ours, axis=0).max()


def centres(file: bytes) -> np.ndarray:
    header, body = file.split(b"end_header\n", 1)
    columns = header.count(b"property float")
    assert header.split(b"property float ")[1].strip() == b"x"
    return np.frombuffer(body, "<f4").reshape(-1, columns)[:, :3]


def test_gltf_is_a_file_for_each_time(finished, tmp_path):
    assert main(["export", "gltf", *finished[1:], "--times", "2", "--out", str(tmp_path / "glb")]) == 0
    files = sorted((tmp_path / "glb").glob("*.glb"))
    assert [file.name for file in files] == ["frame0001.glb", "frame0002.glb"]
    assert all(file.read_bytes()[:4] == b"glTF" for file in files)


@pytest.mark.parametrize("name", ["sh010_v1.2", "take.b/"])
def test_a_new_folder_may_have_a_dot_in_its_name(finished, tmp_path, name):
    assert main(["export", *finished, "--time", "0", "--out", f"{tmp_path}/{name}"]) == 0
    assert sorted(one.name for one in (tmp_path / name).iterdir()) == ["frame0001.ply", "sequence.json"]


def test_a_file_as_folder_is_refused(finished, tmp_path, capsys):
    (tmp_path / "file").write_text("")
    assert main(["export", *finished, "--out", str(tmp_path / "file")]) == 2
    assert "name a folder" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "name"), [(["ply"], "a.ply"), (["ply", "--compressed"], "a.ply"), (["spz"], "a.SPZ"), (["sog"], "a.sog"), (["gltf"], "a.glb")]
)
def test_one_time_is_one_file(finished, tmp_path, words, name):
    command = ["export", words[0], *finished[1:], *words[1:], "--out", str(tmp_path / name)]
    assert main([*command, "--time", "0.3"]) == 0
    first = (tmp_path / name).read_bytes()
    assert first[:3] in (b"ply", b"\x1f\x8b\x08", b"PK\x03", b"glT") and [f.name for f in tmp_path.iterdir()] == [name]
    assert main([*command, "--times", "1"]) == 0 and (tmp_path / name).read_bytes() != first, "the middle time"


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--out", "a.ply"), "a .ply file holds one time"),
        (("--out", "a.ply", "--times", "2"), "and here are 2; add --time 0.5"),
        (("--out", "a.splat", "--time", "0"), "the file must end in .ply"),
        (("--time", "1.5"), "from 0 (first time of the capture) to 1"),
        (("--time", "nan"), "--time nan"),
        (("--time", "0", "--times", "2"), "give one of them"),
        (("--up", "up"), "give one of X, -X, Y, -Y, Z, -Z, or capture"),
    ],
)
def test_a_bad_option_is_one_message(finished, capsys, monkeypatch, tmp_path, options, words):
    monkeypatch.chdir(tmp_path)
    assert main(["export", *finished, *options]) == 2
    assert words in " ".join(capsys.readouterr().err.split()) and not list(tmp_path.iterdir())


def test_antialiased_viewers_get_other_gaussians_and_are_told_so(finished, tmp_path, capsys):
    heads = {}
    for options in ((), ("--antialiased",)):
        assert main(["export", *finished, *options, "--time", "0", "--out", str(tmp_path / "a.ply")]) == 0
        heads[options] = (tmp_path / "a.ply").read_bytes()
    assert b"comment SplatRenderMode: default\n" in heads[()] and b"comment SplatRenderMode: mip\n" in heads[("--antialiased",)]
    assert heads[()].split(b"end_header")[1] != heads[("--antialiased",)].split(b"end_header")[1]
    assert "antialiased (compensated opacity) viewers" in " ".join(capsys.readouterr().out.split())


def test_an_error_in_the_middle_leaves_the_earlier_export(finished, tmp_path, monkeypatch):
    assert main(["export", *finished, "--times", "2", "--out", str(tmp_path)]) == 0
    before = {f.name: f.read_bytes() for f in tmp_path.iterdir()}
    calls = []

    def breaks(file: Path, data: bytes) -> None:
        calls.append(file)
        if len(calls) == 3:
            raise KeyboardInterrupt
        file.write_bytes(data)

    monkeypatch.setattr("e4dgs.stages.exports.splats.write_atomically", breaks)
    assert main(["export", *finished, "--times", "4", "--out", str(tmp_path)]) == 130
    assert len(calls) == 3 and {f.name: f.read_bytes() for f in tmp_path.iterdir()} == before


def test_the_benchmark_reads_every_export_back_by_other_programs(finished, tmp_path, monkeypatch, capsys):
    if readers.splat_transform() is None or readers.node_modules() is None:
        pytest.skip("needs splat-transform, three and gltf-validator from npm; benchmarks/export_readers.py says how to install them")
    out = tmp_path / "exports.json"
    workspace = finished[finished.index("--workspace") + 1]
    monkeypatch.setattr(sys, "argv", ["exports.py", workspace, "--times", "1", "--out", str(out)])
    assert exports.main() == 0, capsys.readouterr().out
    rows = json.loads(out.read_text())["rows"]
    wanted = {*KINDS, "baked", "convexes glb", *([] if problem() else ["mesh glb"])}
    assert wanted <= {row["format"] for row in rows}
    assert all(row["psnr"] >= 45 for row in rows if row["format"] in ("ply", "gltf", "usd"))
