"""Commands that README and docs/ print run as printed, on tiny captures that lie where they say, with tiny budgets behind them."""

import contextlib
import glob
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import urllib.request
from pathlib import Path

import numpy as np
import pytest
import torch
from e4dgs.workflows.batch.listing import Entry, entries_of
from e4dgs.workflows.cli import main
from open3d_here import problem
from printed_commands import PARSED_ONLY, ROOT, RUN, TINY, printed
from public_captures import PUBLIC, TRUTH
from script_module import load_script

# Where each path that a page names comes from.
CAPTURES = {
    "CAPTURE": "nerfstudio_capture",
    "clip.mp4": "video_capture",
    "photos": "images_capture",
    "data/dnerf/lego": "dnerf_capture",
}
NAMES = {"SCENE": "CAPTURE", "SCENE/fine": "CAPTURE/fine", "OTHER/fine": "lego/fine", "CAPTURE...": "CAPTURE"}


@pytest.fixture(scope="module")
def place(request, tmp_path_factory):
    """A folder with all that the pages name, and a workspace in which CAPTURE and `lego` are finished."""
    folder = tmp_path_factory.mktemp("place")
    for name, fixture in CAPTURES.items():
        source = request.getfixturevalue(fixture).root
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (shutil.copytree if source.is_dir() else shutil.copy)(source, folder / name)
    for name, write in PUBLIC.items():
        write(folder / name)
    splits = load_script(ROOT / "benchmarks" / "published_splits.py")
    splits.without(folder / "data/n3v/coffee_martini_all", "cam13", folder / "data/n3v/coffee_martini")
    splits.nvidia(folder / "data/nvidia/Balloon1", folder / "data/nvidia/Balloon1" / TRUTH, folder / "data/nvidia/Balloon1_split")
    (folder / "samples").symlink_to(ROOT / "samples")
    (folder / "captures").mkdir()
    (folder / "captures" / "clip.mp4").symlink_to(folder / "clip.mp4")
    write_garden(folder / "test_garden.npz")
    with contextlib.chdir(folder):
        for command in ("e4dgs run all CAPTURE", "e4dgs run all data/dnerf/lego --preset fast"):
            assert main([*command.split()[1:], *TINY.split()]) == 0
    return folder


@pytest.fixture
def inside(place, monkeypatch):
    monkeypatch.chdir(place)
    return place


def write_garden(path: Path) -> None:
    """Fifty Gaussians under the names that `bench --garden` reads."""
    means = np.random.default_rng(0).normal(size=(50, 3)) * 0.3 + (0, 0, 4)
    K = np.array([[60.0, 0, 32], [0, 60, 24], [0, 0, 1]])[None]
    np.savez(path, means3d=means, colors=np.full((50, 3), 0.5), viewmats=np.eye(4)[None], Ks=K, width=64, height=48)


def test_every_command_is_run_or_says_why_not():
    """A new command belongs into one of the two lists, one that has gone into none."""
    assert not RUN.keys() & PARSED_ONLY.keys()
    assert printed().keys() == RUN.keys() | PARSED_ONLY.keys()
    assert all(len(reason.split()) > 2 for reason in PARSED_ONLY.values())


def words_of(command: str) -> list[str]:
    """What a shell would hand over, names of the pages replaced by those of the place."""
    words = [NAMES.get(word, word) for word in shlex.split(command)]
    return [found for word in words for found in (sorted(glob.glob(word)) if "*" in word else [word])] + shlex.split(RUN[command])


@pytest.mark.parametrize("command", [c for c in RUN if c.startswith("e4dgs ") and not c.startswith("e4dgs view ")])
def test_it_runs(inside, command, capsys):
    if command.startswith("e4dgs export mesh") and "--convexes" not in command and problem():
        pytest.skip(f"Open3D cannot be loaded: {problem()}")
    if command == "e4dgs status":  # the newest batch
        main(words_of("e4dgs batch captures/*.mp4 --name night")[1:])
    assert main(words_of(command)[1:]) == 0, capsys.readouterr().err
    if "--out" in command or "--plot" in command:
        written = inside / command.split("--out " if "--out" in command else "--plot ")[1].split()[0]
        assert list(written.iterdir()) if written.is_dir() else written.with_suffix("").name in str(list(inside.iterdir()))


@pytest.fixture(scope="module")
def environment(tmp_path_factory):
    """An environment of dev.py's that is complete: its programs are those of this Python."""
    spec = {"python": f'exec "{sys.executable}" "$@"\n', "e4dgs": f'exec "{sys.executable}" -m e4dgs.workflows.cli "$@"\n'}
    folder = tmp_path_factory.mktemp("environment")
    (folder / "bin").mkdir()
    for name, line in spec.items():
        (folder / "bin" / name).write_text("#!/bin/sh\n" + line)
        (folder / "bin" / name).chmod(0o755)
    variables = {**os.environ, "E4DGS_VENV": str(folder)}
    code = "import dev, json; dev.STAMP.write_text(json.dumps({'inputs': dev.build_digest(), 'dev': True}))"
    subprocess.run([sys.executable, "-c", code], env=variables, cwd=ROOT, check=True)
    return variables


@pytest.mark.parametrize("command", [c for c in RUN if c.startswith("python3 dev.py")])
def test_dev_py_runs(inside, environment, command):
    words = [str(inside / word) if word == "e4dgs-workspace" else word for word in words_of(command)]
    done = subprocess.run([sys.executable, *words[1:]], cwd=ROOT, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    if command == "python3 dev.py sample":
        assert Path(done.stdout.split()[-1]).is_file(), "the last line is the report's path"
    else:
        assert "passed" in done.stdout


@pytest.mark.parametrize("command", [c for c in RUN if c.startswith("e4dgs view ")])
def test_the_viewer_answers_and_ends(inside, command):
    words = words_of(command)
    if "samples" in command:
        assert main(["run", "all", *words[2:-1]]) == 0
    # Whoever runs the tests in the background may have told all of its processes to ignore Ctrl-C.
    code = "import signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler)\n"
    code += "from e4dgs.workflows.cli import main; sys.exit(main(sys.argv[1:]))"
    server = subprocess.Popen([sys.executable, "-c", code, *words[1:]], stdout=subprocess.PIPE, text=True)
    try:
        assert server.stdout is not None
        address = next(word for word in server.stdout.readline().split() if word.startswith("http"))
        with urllib.request.urlopen(address, timeout=60) as page:
            assert page.status == 200 and b"<html" in page.read().lower()
        server.send_signal(signal.SIGINT)
        assert server.wait(timeout=60) == 0, "Ctrl-C ends it, which is no failure"
    finally:
        server.kill()
        server.wait()


def block(page: str, language: str) -> str:
    found = re.search(rf"```{language}\n(.*?)```", (ROOT / page).read_text(), re.DOTALL)
    assert found
    return found[1]


def test_the_script_of_the_results_page_runs(inside, request):
    truth = request.getfixturevalue("nerfstudio_capture").views[0].camera
    names = {
        "K": torch.tensor(truth.K).float(),
        "cam_from_world": torch.tensor(truth.cam_from_world).float(),
        "width": truth.width,
        "height": truth.height,
    }
    exec(block("docs/results.md", "python").replace("<name>", "CAPTURE"), names)
    frame = names["frame"]
    size = (truth.height, truth.width)
    assert (frame.color.shape, frame.alpha.shape, frame.depth.shape) == ((*size, 3), size, size)
    assert float(frame.alpha.mean()) > 0.1 and bool(torch.isfinite(frame.color).all())


def test_the_list_of_the_batches_page_is_read(inside):
    folder = inside / "listed"
    (folder / "captures" / "garden").mkdir(parents=True)
    shutil.copy("clip.mp4", folder / "captures" / "band.mp4")
    (folder / "scenes.yaml").write_text(block("docs/batches.md", "yaml"))
    entries = entries_of([str(folder / "scenes.yaml")], Entry("", ""))
    assert len(entries) == 6 and {entry.preset for entry in entries} == {"fast"}
    assert [dict(entry.settings)["coarse.iterations"] for entry in entries if "band" in entry.name] == ["3000"] * 3
