"""The command line on a toy reconstruction: `cli("run", "all", path)` returns exit code, output and errors."""

import fcntl
import os
import shutil
import sys
import types
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parent))

import tiny_run
import toy_reconstruction


class Result(NamedTuple):
    code: int
    out: str
    err: str


@pytest.fixture
def cli(tmp_path, monkeypatch, capsys):
    """Runs a command in an empty folder, whose workspace is ``e4dgs-workspace``."""
    from e4dgs.workflows import cli as module

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("e4dgs.workflows.session.reconstruction", toy_reconstruction.toy_reconstruction)
    report = types.ModuleType("e4dgs.stages.report.page")
    report.render_report = toy_reconstruction.render_report
    monkeypatch.setitem(sys.modules, "e4dgs.stages.report.page", report)
    monkeypatch.setattr("signal.signal", lambda *args: None)

    def run(*arguments: object) -> Result:
        monkeypatch.setattr(module, "console", module.Console(width=200, force_terminal=False))
        code = module.main([str(argument) for argument in arguments])
        captured = capsys.readouterr()
        return Result(code, captured.out, captured.err)

    return run


@pytest.fixture
def capture(tmp_path) -> Path:
    """A folder of five tiny pictures."""
    from PIL import Image

    folder = tmp_path / "captures" / "my scene"
    folder.mkdir(parents=True)
    for i in range(5):
        Image.new("RGB", (32, 24), (40 * i, 0, 0)).save(folder / f"{i:03d}.png")
    return folder


@pytest.fixture
def short_fit(monkeypatch):
    """How well convexes are fitted is for tests/stages/test_splat_bake.py."""
    monkeypatch.setattr("e4dgs.stages.exports.bake.STEPS", 5)


@pytest.fixture(scope="session")
def finished_run(dnerf_capture, tmp_path_factory):
    """A tiny capture and the workspace in which it was reconstructed; others add to the workspace and take nothing away. Several processes
    of the tests reconstruct it once, and each has a copy of the workspace."""
    from e4dgs.workflows.cli import main

    own = tmp_path_factory.getbasetemp()
    made = (own.parent if "PYTEST_XDIST_WORKER" in os.environ else own) / "made"
    capture, workspace, whole = made / dnerf_capture.root.name, made / "workspace", made / "whole"
    made.mkdir(exist_ok=True)
    with (made / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not whole.exists():
            shutil.copytree(dnerf_capture.root, capture, dirs_exist_ok=True)
            assert main(["run", "all", str(capture), "--workspace", str(workspace), *tiny_run.QUICK]) == 0
            whole.touch()
    copy = shutil.copytree(workspace, tmp_path_factory.mktemp("finished") / "workspace", symlinks=True)
    return replace(dnerf_capture, root=capture), copy


@pytest.fixture(scope="session")
def finished_scene(finished_run):
    """The model of the finished run, and the camera of its first view."""
    import e4dgs
    import torch

    capture, workspace = finished_run
    model, truth = e4dgs.load(capture.root, workspace=workspace), capture.views[0].camera
    pose = torch.tensor(truth.cam_from_world).float()
    return model, e4dgs.Camera(torch.tensor(truth.K).float(), pose, truth.width, truth.height, model.near)


@pytest.fixture(scope="module")
def browser():
    """A real Chromium; of a module, since its event loop would be in the way of other tests."""
    if tiny_run.CHROMIUM is None:
        pytest.skip("needs Chromium: apt-get install chromium")
    with tiny_run.started() as browser:
        yield browser
