"""What the engine costs: a cached run, a plan of 1,000 scenes, a stage, and the store beside plain copying and BLAKE3.

    python benchmarks/overhead.py [--scenes 1000] [--megabytes 256] [--out FILE.json]    exit 1 where a bar is missed

The cached run is `e4dgs run all` on samples/cube_and_ball, in a process of its own. Scenes to plan have seven stages each, and all of their
results are files of their own; their captures are tiny, since a plan digests every byte of a capture. Contenders run in turns; the best
time of each counts, the median stands beside it.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from blake3 import blake3
from e4dgs.pipeline import Graph, Job, Records, Runner, Settings, Stage, Store, make_plan
from e4dgs.pipeline.keys import key_of
from e4dgs.pipeline.storage.adopt import adopt
from e4dgs.workflows.bench.machine import machine

ROOT = Path(__file__).resolve().parents[1]
SAMPLE = ROOT / "samples" / "cube_and_ball"
QUICK = ["--set", "coarse.iterations=20", "--set", "hulls.budget=0", "--set", "fine.iterations=0", "--device", "cpu"]
BARS = {"cached_run_seconds": 2.0, "cached_run_mb": 150.0, "plan_seconds_for_1000": 10.0, "stage_ms": 50.0, "store_ratio": 1.3}


@dataclass
class Tiny:
    """A capture of one small file."""

    root: Path
    name: str = "tiny"
    files: tuple[str, ...] = ("numbers.txt",)

    @property
    def facts(self) -> Mapping[str, Any]:
        return {}


def stages() -> Graph:
    """A chain of seven, each with an array and attrs of its own."""

    def run(self: Stage, ctx: Any) -> None:
        ctx.out.write("values", np.arange(1000.0))
        ctx.out.attrs["stage"] = self.name

    names = [f"stage{k}" for k in range(7)]
    made = []
    for k, name in enumerate(names):
        fields = {"name": name, "inputs": (names[k - 1],) if k else (), "reads_capture": True, "settings": Settings, "run": run}
        made.append(type(name, (Stage,), fields)())
    return Graph(made)


def job_of(folder: Path, scene: int, graph: Graph) -> Job:
    capture = folder / "captures" / str(scene)
    if not capture.is_dir():
        capture.mkdir(parents=True)
        (capture / "numbers.txt").write_text(str(scene))
    records = Records(folder / "scenes" / str(scene) / "records")
    return Job(graph, Tiny(capture), {stage.name: Settings() for stage in graph}, Store(folder / "store"), records)


def fill(folder: Path, graph: Graph, scenes: int) -> None:
    """Results of all scenes: those of the first one under the keys of the others."""
    outcomes = Runner(job_of(folder, 0, graph)).run()
    digests = {outcome.stage: outcome.artifact.digest for outcome in outcomes if outcome.artifact is not None}
    for scene in range(1, scenes):
        job = job_of(folder, scene, graph)
        for outcome, stage in zip(outcomes, graph):
            assert outcome.artifact is not None
            parts = job.parts(stage, {name: digests[name] for name in stage.inputs})
            shutil.copytree(outcome.artifact.path, job.store.path(stage.name, key_of(parts)))
            job.records.folder.mkdir(parents=True, exist_ok=True)
            record = {"key": key_of(parts), "parts": parts, "digest": digests[stage.name]}
            (job.records.folder / f"{stage.name}.json").write_text(json.dumps(record))


def in_turns(rounds: int, **contenders: Callable[[], object]) -> dict[str, dict[str, float]]:
    """Seconds of each contender: best and median; the least time of the processor tells what others took from a busy machine."""
    times: dict[str, list[float]] = {name: [] for name in contenders}
    used: dict[str, list[float]] = {name: [] for name in contenders}
    for _ in range(rounds):
        for name, contender in contenders.items():
            started, before = time.perf_counter(), time.process_time()
            contender()
            times[name].append(time.perf_counter() - started)
            used[name].append(time.process_time() - before)
    return {name: {"best": min(found), "median": statistics.median(found), "cpu": min(used[name])} for name, found in times.items()}


def cached_run(folder: Path, rounds: int = 7) -> dict[str, Any]:
    words = ["run", "all", str(SAMPLE), "--workspace", str(folder / "workspace"), *QUICK]
    subprocess.run([sys.executable, "-m", "e4dgs.workflows.cli", *words], check=True, capture_output=True)
    code = (  # the peak of its own: what wait4 tells of a child counts this process's memory, too
        f"import sys\nfrom e4dgs.workflows.cli import main\nassert main({words!r}) == 0\n"
        "peak = next(line for line in open('/proc/self/status') if line.startswith('VmHWM')).split()[1]\n"
        "print(int('torch' in sys.modules), peak, file=sys.stderr)"
    )
    times, memory, processor, torch = [], [], [], False
    for _ in range(rounds):
        started = time.perf_counter()
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        done = subprocess.run([sys.executable, "-c", code], check=True, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
        times.append(time.perf_counter() - started)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        processor.append(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)
        imported, peak = map(int, done.stderr.split())
        memory.append(peak * 1024 / 1e6)
        torch |= bool(imported)
    seconds = {"best": min(times), "median": statistics.median(times), "cpu": min(processor)}
    return {"seconds": seconds, "mb": max(memory), "torch_imported": torch}


def engine(folder: Path, scenes: int) -> dict[str, Any]:
    """Seconds for the plan of all scenes, and milliseconds for one stage: planned, cached in a run, and run (with next to no work)."""
    graph = stages()
    fill(folder, graph, scenes)

    def plan() -> None:
        for scene in range(scenes):
            assert all(row.state == "cached" for row in make_plan(job_of(folder, scene, graph)))

    def cached() -> None:
        assert all(outcome.state == "cached" for outcome in Runner(job_of(folder, 1, graph)).run())

    last = [stage.name for stage in graph][-1]

    def run() -> None:
        Runner(job_of(folder, 1, graph)).run(force=[stage.name for stage in graph if stage.name != last])

    planned = in_turns(3, plan=plan)["plan"]
    each = in_turns(10, cached=cached, run=run)
    counts = {"cached": 7, "run": 6, "planned": 7 * scenes}
    each["planned"] = planned
    milliseconds = {name: {kind: 1e3 * value / counts[name] for kind, value in found.items()} for name, found in each.items()}
    return {"scenes": scenes, "plan_seconds": planned, "stage_ms": milliseconds}


def throughput(folder: Path, megabytes: int) -> dict[str, Any]:
    """An array of noise written, read, verified and taken over, beside a plain file that is written, read and copied, with BLAKE3."""
    data = np.random.default_rng(0).integers(0, 256, (megabytes, 1_000_000), dtype=np.uint8)
    store, plain, copy = Store(folder / "large"), folder / "plain.bin", folder / "copy.bin"

    def write(key: str = "a") -> None:
        with store.lock("s", key), store.writing("s", key) as writer:
            writer.write("x", data)
            store.publish(writer, "s", key, {})

    def digest(path: Path) -> str:
        return blake3(max_threads=blake3.AUTO).update_mmap(path).hexdigest()

    def plain_write(path: Path = plain) -> None:
        with open(path, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        digest(path)

    def plain_copy() -> None:
        shutil.copyfile(plain, copy)
        with open(copy, "rb") as file:
            os.fsync(file.fileno())
        digest(copy)

    def take_over(link: bool) -> None:
        other = Store(folder / "other")
        shutil.rmtree(other.root, ignore_errors=True)
        known = os.link
        if not link:
            os.link = _refuse  # as between two file systems
        try:
            adopt(other, store.open("s", "a"), "s", "a")
        finally:
            os.link = known

    found = in_turns(
        4,
        write=write,
        plain_write=plain_write,
        verify=lambda: store.open("s", "a").verify(),
        plain_digest=lambda: digest(plain),
        read=lambda: store.open("s", "a").read("x"),
        plain_read=lambda: blake3(max_threads=blake3.AUTO).update(np.fromfile(plain, np.uint8)).hexdigest(),
        copied=lambda: take_over(False),
        plain_copy=plain_copy,
        linked=lambda: take_over(True),
    )
    pairs = {"write": "plain_write", "verify": "plain_digest", "read": "plain_read", "copied": "plain_copy", "linked": "plain_copy"}
    ratios = {name: found[name]["best"] / found[other]["best"] for name, other in pairs.items()}
    return {"megabytes": megabytes, "seconds": found, "ratio_to_plain": ratios}


def missed(result: Mapping[str, Any]) -> list[str]:
    """A line for every bar that a result does not hold; wall seconds are medians, of the store's ratios the largest counts."""
    cached, engine = result["cached run"], result["engine"]
    found = {
        "cached_run_seconds": cached["seconds"]["median"],
        "cached_run_mb": cached["mb"],
        "plan_seconds_for_1000": 1000 * engine["plan_seconds"]["median"] / engine["scenes"],
        "stage_ms": max(times["median"] for times in engine["stage_ms"].values()),
        "store_ratio": max(result["store"]["ratio_to_plain"].values()),
    }
    lines = [f"{name}: {found[name]:.4g}, and the bar is {bar:g}" for name, bar in BARS.items() if not found[name] <= bar]
    return lines + (["a cached run imports torch"] if cached["torch_imported"] else [])


def _refuse(*_: object, **__: object) -> None:
    raise OSError(18, "another file system")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", type=int, default=1000)
    parser.add_argument("--megabytes", type=int, default=256)
    parser.add_argument("--out", type=Path, default=ROOT / "benchmarks" / "results" / "overhead.json")
    args = parser.parse_args()
    result: dict[str, Any] = {"machine": machine(), "bars": BARS}
    parts = {"store": lambda folder: throughput(folder, args.megabytes), "engine": lambda folder: engine(folder, args.scenes)}
    for name, measure in (parts | {"cached run": cached_run}).items():
        load = os.getloadavg()[0]
        with tempfile.TemporaryDirectory() as folder:
            result[name] = {"load_before": load} | measure(Path(folder))
        rounded = json.loads(json.dumps(result), parse_float=lambda text: round(float(text), 4))
        args.out.write_text(json.dumps(rounded, indent=1) + "\n")  # after each: what is measured is not lost with the rest
        print(name, json.dumps(rounded[name], indent=1), flush=True)
    if lines := missed(result):
        sys.exit("\n".join(lines))


if __name__ == "__main__":
    main()
