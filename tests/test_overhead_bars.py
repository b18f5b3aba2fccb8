"""The bars of benchmarks/overhead.py: what was measured holds them, and what a test can measure anywhere does, too.

Seconds are the processor's, and are compared with others of the same run: a busy machine makes no test fail.
"""

import copy
import json
import resource
import subprocess
import sys
import time
from pathlib import Path

import pytest
from blake3 import blake3
from e4dgs.pipeline import make_plan
from e4dgs.stages.coarse.stage import Coarse
from e4dgs.stages.evaluate.stage import Evaluate
from e4dgs.workflows.runs import execute
from e4dgs.workflows.session import Choice, Options, open_session
from rich.console import Console
from script_module import load_script

ROOT = Path(__file__).resolve().parents[1]
WORDS = ["hulls.budget=0", "fine.iterations=0"]
MEASURED = (  # the memory is the process's own: what the system says of a child counts this process, too
    "import json, resource, sys\n"
    "from e4dgs.workflows.cli import main\n"
    "code = main(sys.argv[1:])\n"
    "peak = next(line for line in open('/proc/self/status') if line.startswith('VmHWM')).split()[1]\n"
    "print('\\n' + json.dumps([code, int(peak) * 1024 / 1e6, 'torch' in sys.modules]))"
)


@pytest.fixture(scope="module")
def overhead():
    return load_script(ROOT / "benchmarks" / "overhead.py")


@pytest.fixture
def committed() -> dict:
    return json.loads((ROOT / "benchmarks" / "results" / "overhead.json").read_text())


def test_the_committed_result_holds_the_bars(overhead, committed):
    assert committed["bars"] == overhead.BARS, "run benchmarks/overhead.py again"
    assert committed["engine"]["scenes"] == 1000 and committed["store"]["megabytes"] >= 256
    assert overhead.missed(committed) == []
    best = [committed["engine"]["plan_seconds"]["best"], committed["engine"]["stage_ms"]["run"]["best"]]
    assert (
        f"| {best[0]:.1f} ms to plan a scene, {best[1]:.0f} ms for each stage that runs"
        in (ROOT / "benchmarks" / "results" / "scale.md").read_text()
    )


@pytest.mark.parametrize(
    ("place", "value", "bar"),
    [
        (("cached run", "seconds", "median"), 2.1, "cached_run_seconds"),
        (("cached run", "mb"), 151.0, "cached_run_mb"),
        (("cached run", "torch_imported"), True, "torch"),
        (("engine", "plan_seconds", "median"), 10.1, "plan_seconds_for_1000"),
        (("engine", "stage_ms", "run", "median"), 50.1, "stage_ms"),
        (("store", "ratio_to_plain", "copied"), 1.31, "store_ratio"),
        (("store", "ratio_to_plain", "copied"), float("nan"), "store_ratio"),
    ],
)
def test_a_bar_that_is_missed_is_named(overhead, committed, place, value, bar):
    worse = copy.deepcopy(committed)
    *folders, last = place
    part = worse
    for name in folders:
        part = part[name]
    part[last] = value
    if value != value:
        worse["store"]["ratio_to_plain"] = {"copied": value}
    (line,) = overhead.missed(worse)
    assert bar in line


@pytest.fixture
def cached(dnerf_capture, tmp_path, monkeypatch) -> list[str]:
    """The words of a `run all` of which everything is cached: what training and measuring write is small, the rest is real."""

    def train(self, ctx) -> None:
        ctx.out.attrs["static"] = False

    def measure(self, ctx) -> None:
        ctx.out.attrs["metrics"] = {"protocol": {"split": "test"}, "splits": {"test": {"psnr": 20.0}}, "primitives": {}}

    monkeypatch.setattr(Coarse, "run", train)
    monkeypatch.setattr(Evaluate, "run", measure)
    monkeypatch.setattr("e4dgs.workflows.publish._render", lambda *arguments: "<html>")
    session = open_session(Options(dnerf_capture.root, tmp_path / "w", Choice(set=WORDS, device="cpu")))
    execute(session, make_plan(session.job), Console(quiet=True), lambda line: None)
    settings = [word for assignment in WORDS for word in ("--set", assignment)]
    return ["run", "all", str(dnerf_capture.root), "--workspace", str(tmp_path / "w"), "--device", "cpu", *settings]


def alone(*words: str) -> tuple[str, float]:
    """Output and processor seconds of the command line in a process of its own."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run([sys.executable, "-c", MEASURED, *words], check=True, capture_output=True, text=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return done.stdout, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def test_a_cached_run_of_everything_is_light(overhead, cached):
    """Measured: 62 MB, and 1.6 times the processor seconds of `run --help`, most of both for imports."""
    output, seconds = min((alone(*cached) for _ in range(2)), key=lambda found: found[1])
    _, least = min((alone("run", "--help") for _ in range(2)), key=lambda found: found[1])
    code, megabytes, torch = json.loads(output.splitlines()[-1])
    assert code == 0 and "evaluate" in output and "done in" not in output, output
    assert megabytes < overhead.BARS["cached_run_mb"] and not torch
    assert seconds < 5 * least, f"{seconds:.2f} s of the processor, and {least:.2f} s for help"


def test_a_plan_of_hundreds_of_cached_scenes_takes_a_small_multiple_of_reading_their_files(overhead, tmp_path):
    """Measured 4 times; scanning the store for each scene would be a hundred times."""
    scenes, graph = 200, overhead.stages()
    overhead.fill(tmp_path, graph, scenes)
    files = [path for path in (tmp_path / "store").rglob("*") if path.is_file()]
    assert len(files) >= 7 * scenes
    planned, plain = [], []
    for _ in range(2):
        started = time.process_time()
        for scene in range(scenes):
            assert {row.state for row in make_plan(overhead.job_of(tmp_path, scene, graph))} == {"cached"}
        planned.append(time.process_time() - started)
        started = time.process_time()
        for path in files:
            blake3(path.read_bytes()).hexdigest()
        plain.append(time.process_time() - started)
    assert min(planned) < 15 * min(plain), f"{min(planned):.2f} s for {scenes} scenes, {min(plain):.2f} s for reading their files"


def test_a_batch_is_faster_than_its_scenes_one_after_the_other():
    measured = json.loads((ROOT / "benchmarks" / "results" / "throughput.json").read_text())
    bars, speedup = load_script(ROOT / "benchmarks" / "throughput.py").BARS, measured["speedup"]
    assert measured["bars"] == bars and measured["protocol"]["scenes"] >= 12
    assert speedup["batch, 2 workers"] >= bars["speedup_of_2_workers"]
    assert min(speedup.values()) >= bars["speedup_of_any"]
