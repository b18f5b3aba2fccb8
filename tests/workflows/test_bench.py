"""`e4dgs bench`: every row at a tiny size, and what is printed and written."""

import errno
import json
import math

import numpy as np
import pytest
import torch
from e4dgs.pipeline import SettingsError
from e4dgs.workflows.bench import output, scenes
from e4dgs.workflows.bench.rows import Bench, Check
from e4dgs.workflows.bench.suites import SUITES
from e4dgs.workflows.bench.threads import over_threads
from e4dgs.workflows.bench.timing import interleaved
from pretended.gpu import pretended_gpu
from simt import needs_compiler

pytestmark = pytest.mark.usefixtures("one_thread")
TINY = ("--scale", "0.001", "--repeats", "1", "--seconds", "0")
ROWS = [(suite, row.name) for suite, rows in SUITES.items() for row in rows]


@pytest.fixture
def cli(cli, monkeypatch):
    """The command line on the real reconstruction, whose stages read the capture of a step."""
    from e4dgs.workflows.reconstruction import reconstruction

    monkeypatch.setattr("e4dgs.workflows.session.reconstruction", reconstruction)
    return cli


@pytest.fixture
def gpu(monkeypatch):
    monkeypatch.setattr("e4dgs.workflows.bench.cuda.first_use._seconds", lambda cache: 1.0)
    with pretended_gpu():
        yield


@pytest.mark.parametrize(("suite", "row"), [pytest.param(*row, marks=needs_compiler if row[0] == "cuda" else ()) for row in ROWS])
def test_every_row_measures_and_writes(request, cli, tmp_path, suite, row):
    out = tmp_path / "out.json"
    if suite == "cuda":
        request.getfixturevalue("gpu")
    threads = 2 if suite in ("raster", "field") else 1  # these compare the two
    result = cli("bench", suite, "--rows", row, "--out", out, "--debug", *TINY, "--threads", threads)
    assert result.code == 0, result.err
    written = json.loads(out.read_text())
    assert {"processor", "cores", "compiler", "versions", "date", "commit", "kernels", "threads"} <= written["machine"].keys()
    assert written["machine"]["versions"]["torch"] == torch.__version__
    assert written["protocol"]["scale"] == 0.001 and not written["protocol"]["judged"]
    (found,) = written["rows"].values()
    assert found["protocol"] and found["checks"]
    for check in found["checks"]:
        assert check["value"] is not None and math.isfinite(check["value"]), check
        if check["bar"] is not None:
            assert "not judged" in result.out and check["passed"] in (True, False)


def test_list_names_every_row_and_measures_nothing(cli):
    for suite, rows in SUITES.items():
        lines = cli("bench", suite, "--list").out.splitlines()
        assert [line.split()[0] for line in lines] == [row.name for row in rows]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("raster", "--rows", "garden,nope"), "--rows nope: there is no such row; rows: garden, convexes"),
        (("raster", "--garden", "nope.npz"), "--garden nope.npz: there is no such file"),
        (("raster", "--out", "."), "--out .: this is a folder; name a file, for example raster.json"),
        (("field", "--rows", ","), "--rows names no row; rows: field, loss, adam"),
        (("step", "--capture", "nope", "--rows", "split"), "nope"),
        (("cuda", "--rows", "agreement"), "there is nothing to measure on"),
    ],
)
def test_a_bad_argument_is_one_message(cli, arguments, message):
    result = cli("bench", *arguments)
    assert result.code == 2 and message in result.err


def test_a_bar_holds_on_its_own_side_only():
    assert Check("ratio", 3.0, 2.0).passed is False and Check("ratio", 1.0, 2.0).passed is True
    assert Check("ratio", 3.0, 2.0, "above").passed is True and Check("ratio", 1.0).passed is None
    assert Check("ratio", float("nan"), 2.0).passed is False and Check("ratio", float("nan"), 2.0, "above").passed is False


def test_contenders_take_turns_and_one_that_is_slow_runs_less():
    order = []
    clock = {"fast": lambda: order.append("fast"), "slow": lambda: order.append("slow")}
    times = interleaved(Bench(seconds=20), clock, 3)
    assert order == ["fast", "slow", "fast", "slow", "slow", "fast", "fast", "slow"]
    assert [len(t.runs) for t in times.values()] == [3, 3]
    assert len(interleaved(Bench(seconds=0), clock, 3)["slow"].runs) == 1


def test_all_threads_take_turns_with_one_and_must_not_take_longer():
    seen = []
    torch.set_num_threads(2)
    found = over_threads(Bench(repeats=1), "nothing", {"a run": lambda: seen.append(torch.get_num_threads())})
    assert seen == [2, 1, 2, 1] and torch.get_num_threads() == 2
    times = found.numbers["times"]
    (check,) = found.checks
    assert check.value == times["a run, 2 threads"]["best_s"] / times["a run, 1 thread"]["best_s"] and check.bar == 1
    torch.set_num_threads(1)
    alone = over_threads(Bench(repeats=1), "nothing", {"a run": lambda: None})
    assert not alone.checks and list(alone.numbers["times"]) == ["a run, 1 thread"]


def test_the_parts_of_a_step_sum_to_the_whole_and_nothing_stays_wrapped():
    from e4dgs.scene.losses import appearance
    from e4dgs.scene.training import objective
    from e4dgs.workflows.bench.step import split

    before = torch.Tensor.backward, objective.rasterize, appearance.appearance_loss
    found = split.measure(Bench(scale=0.02, repeats=2))
    assert before == (torch.Tensor.backward, objective.rasterize, appearance.appearance_loss)
    parts = found.numbers["parts_ms"]
    assert sum(parts.values()) == pytest.approx(found.numbers["whole_ms"], rel=0.05)
    assert all(parts[part] > 0 for part in split.PARTS)


def test_the_garden_scene_is_read_from_its_file(tmp_path):
    path = tmp_path / "garden.npz"
    rng = np.random.default_rng(0)
    K = np.array([[[30.0, 0, 16], [0, 30, 12], [0, 0, 1]]])
    arrays = {"means3d": rng.normal((0, 0, 4), 1, (50, 3)), "colors": rng.integers(0, 256, (50, 3)), "Ks": K}
    np.savez(path, **arrays, viewmats=np.eye(4)[None], width=64, height=48)
    scene, name = scenes.garden(Bench(garden=path))
    assert name == "garden.npz, 50 Gaussians, 64x48"
    assert torch.equal(scene.gaussians.means, torch.tensor(arrays["means3d"], dtype=torch.float32))
    half, _ = scenes.garden(Bench(scale=0.25, garden=path))
    assert len(half.gaussians.means) == 13 and half.camera.width == 32 and float(half.camera.K[0, 0]) == 15
    np.savez(path, means3d=arrays["means3d"])
    with pytest.raises(SettingsError, match=r"garden\.npz: expected arrays means3d, colors"):
        scenes.garden(Bench(garden=path))


def test_numbers_of_earlier_rows_survive_a_disk_that_fills_up(tmp_path, monkeypatch):
    """The file is written again after each row."""

    def full(descriptor: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    out = tmp_path / "new" / "out.json"
    output.write(out, {"rows": {"a": float("nan")}})
    monkeypatch.setattr("e4dgs.pipeline.files.os.fsync", full)
    with pytest.raises(OSError, match="No space left"):
        output.write(out, {"rows": {"a": 1, "b": 2}})
    assert json.loads(out.read_text()) == {"rows": {"a": None}}
