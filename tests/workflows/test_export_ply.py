"""`e4dgs export ply` writes a file a time, and says how far the convexes' Gaussians are from the convexes."""

import re

import pytest
from e4dgs.workflows.cli import main

QUICK = ["--set", "coarse.iterations=40", "--set", "hulls.budget=20", "--set", "fine.iterations=10", "--device", "cpu"]


@pytest.fixture(scope="module")
def finished(dnerf_capture, tmp_path_factory):
    workspace = tmp_path_factory.mktemp("ply") / "workspace"
    assert main(["run", "all", str(dnerf_capture.root), "--workspace", str(workspace), *QUICK]) == 0
    return ["ply", str(dnerf_capture.root), "--workspace", str(workspace), *QUICK]


def test_a_file_for_each_time(finished, tmp_path, capsys):
    assert main(["export", *finished, "--times", "3", "--out", str(tmp_path / "ply")]) == 0
    files = sorted((tmp_path / "ply").iterdir())
    assert [f.name for f in files] == ["frame0001.ply", "frame0002.ply", "frame0003.ply"]
    assert files[0].read_bytes() != files[2].read_bytes(), "something moves"
    said = " ".join(capsys.readouterr().out.split())
    found = re.search(r"(\d+) convexes became Gaussians: ([\d.]+) dB", said)
    assert found and int(found[1]) > 0 and float(found[2]) > 15


def test_without_times_there_is_a_file_for_each_of_the_capture(finished, tmp_path):
    assert main(["export", *finished, "--out", str(tmp_path)]) == 0
    assert 1 < len(list(tmp_path.iterdir())) <= 60


def test_a_file_as_folder_is_refused(finished, tmp_path, capsys):
    (tmp_path / "file").write_text("")
    assert main(["export", *finished, "--out", str(tmp_path / "file")]) == 2
    assert "name a folder" in capsys.readouterr().err
