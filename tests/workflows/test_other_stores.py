"""`--store-also`, and workspaces that can only be read."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from e4dgs.workflows.batch.ledger import Ledger
from e4dgs.workflows.cli import main

QUICK = ["--set", "coarse.iterations=20", "--set", "hulls.budget=0", "--set", "fine.iterations=0", "--device", "cpu"]


def test_another_workspaces_results_are_taken(cli, capture):
    cli("run", "all", capture, "--workspace", "theirs")
    theirs = Path("theirs").resolve()
    for place in ("theirs", "theirs/store"):
        out = cli("plan", capture, "--store-also", place, "--json").out
        rows = json.loads(out)["stages"]
        assert [(row["state"], row["reason"]) for row in rows] == [("cached", f"is taken from {theirs / 'store'}")] * 3
    result = cli("run", "all", capture, "--store-also", "theirs")
    assert result.code == 0 and result.out.count("taken from") == 6 and "done in" not in result.out  # in the plan, and when it is done
    shutil.rmtree("theirs")
    assert "done in" not in cli("run", "all", capture).out
    result = cli("run", "all", capture, "--store-also", "theirs")
    assert result.code == 2 and "--store-also theirs: there is no such folder" in result.err


@pytest.fixture(scope="module")
def read_only(dnerf_capture, tmp_path_factory):
    """A finished workspace without any right to write, and the words before a command that take root's power to do so all the same."""
    workspace = tmp_path_factory.mktemp("read-only") / "workspace"
    assert main(["run", "all", str(dnerf_capture.root), "--workspace", str(workspace), *QUICK]) == 0
    prefix: list[str] = []
    if os.geteuid() == 0:
        if shutil.which("setpriv") is None:
            pytest.skip("root can write everywhere, and setpriv (util-linux), which takes that from it, is not here")
        prefix = ["setpriv", "--bounding-set", "-dac_override,-dac_read_search,-fowner"]
    places = [workspace, *workspace.rglob("*")]
    for path in places:
        path.chmod(path.stat().st_mode & ~0o222)
    yield workspace, prefix
    for path in places:
        path.chmod(path.stat().st_mode | 0o200)


def run(read_only, *words: object) -> subprocess.CompletedProcess:
    workspace, prefix = read_only
    command = [*prefix, sys.executable, "-m", "e4dgs.workflows.cli", *map(str, words)]
    return subprocess.run([*command, *(() if "--workspace" in words else ("--workspace", str(workspace)))], capture_output=True, text=True)


def test_a_workspace_that_is_read_only_can_be_read(read_only, dnerf_capture, tmp_path):
    workspace, prefix = read_only
    capture, scene = dnerf_capture.root, dnerf_capture.root.name
    touched = subprocess.run([*prefix, "touch", str(workspace / "x")], capture_output=True)
    assert touched.returncode != 0, "the test is about a workspace that cannot be written"
    pictures = tmp_path / "pictures"
    for words in (
        ("plan", capture, *QUICK),
        ("why", "coarse", capture, *QUICK),
        ("verify",),
        ("gc", "--dry-run"),
        ("list",),
        ("show", scene, "coarse"),
        ("diff", f"{scene}/coarse", f"{scene}/coarse"),
        ("render", capture, "--path", "turntable", "--frames", 1, "--out", pictures, *QUICK),
    ):
        done = run(read_only, *words)
        assert done.returncode == 0, f"{words}: {done.stdout}{done.stderr}"
    assert len(list(pictures.glob("*.png"))) == 1


def test_the_viewer_shows_what_can_only_be_read(read_only, dnerf_capture):
    workspace, prefix = read_only
    words = ["view", str(dnerf_capture.root), "--no-browser", "--port", "8911", "--workspace", str(workspace), *QUICK]
    command = [*prefix, sys.executable, "-u", "-m", "e4dgs.workflows.cli", *words]
    viewer = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    try:
        lines = []
        for line in viewer.stdout:
            lines.append(line)
            if "coarse, finished: http://" in line:
                break
        else:
            pytest.fail("".join(lines))
    finally:
        viewer.terminate()
        viewer.wait(timeout=20)


@pytest.mark.parametrize("command", ["run", "force", "gc", "pin", "batch", "export", "report", "archive"])
def test_what_has_to_write_there_says_so_in_one_message(read_only, dnerf_capture, tmp_path, command):
    workspace, _ = read_only
    capture = dnerf_capture.root
    archive = shutil.make_archive(str(tmp_path / "packed"), "zip", capture) if command == "archive" else ""
    words = {
        "report": ("report", capture, *QUICK),
        "archive": ("plan", archive),
        "run": ("run", "coarse", capture, *QUICK, "--set", "coarse.seed=3"),
        "force": ("run", "frames", capture, "--force", *QUICK),
        "gc": ("store", "gc"),
        "pin": ("store", "pin", capture.name),
        "batch": ("batch", capture, *QUICK),
        "export": ("export", "ply", capture, "--times", 1, *QUICK, "--name", "other"),
    }[command]
    done = run(read_only, *words)
    assert done.returncode == 1 and done.stderr.count("error: ") == 1, done.stdout + done.stderr
    assert done.stderr.startswith(f"error: {workspace}") and "cannot be written (Permission denied)" in done.stderr
    assert f"--store-also {workspace}" in done.stderr


def test_of_a_workspace_that_cannot_be_made_no_results_are_promised(read_only, dnerf_capture):
    workspace = read_only[0] / "new"
    for words in (("run", "frames", dnerf_capture.root, *QUICK), ("batch", dnerf_capture.root, *QUICK)):
        done = run(read_only, *words, "--workspace", workspace)
        said = f"error: {workspace}: cannot be written (Permission denied), and this command has to; give another --workspace\n"
        assert (done.returncode, done.stderr) == (1, said)


@pytest.mark.parametrize("name", ["scene.mp4", "pictures", "new/scene.mp4"])
def test_a_render_cannot_be_written_there(read_only, dnerf_capture, name):
    workspace, _ = read_only
    done = run(read_only, "render", dnerf_capture.root, "--path", "capture", "--frames", 1, "--out", workspace / name, *QUICK)
    said = f"error: render: --out {workspace / name}: {workspace} cannot be written; give another --out\n"
    assert (done.returncode, done.stderr) == (1, said)


def test_its_results_are_taken_by_another_workspace(read_only, dnerf_capture, tmp_path):
    words = ["--workspace", tmp_path / "own", "--store-also", read_only[0], *QUICK]
    done = run(read_only, "run", "all", dnerf_capture.root, *words)
    assert done.returncode == 0 and "done in" not in done.stdout, done.stdout + done.stderr
    assert "coarse: taken from" in done.stdout
    assert not list((tmp_path / "own" / "store" / "tmp").iterdir())


def test_a_batch_takes_them_too(read_only, dnerf_capture, tmp_path):
    done = run(read_only, "batch", dnerf_capture.root, "--workspace", tmp_path / "own", "--store-also", read_only[0], *QUICK)
    assert done.returncode == 0, done.stdout + done.stderr
    log = Ledger(tmp_path / "own", "batch").log(dnerf_capture.root.name).read_text()
    assert "coarse: taken from" in log and "done in" not in log
