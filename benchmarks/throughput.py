"""How much faster a batch is than its scenes one after the other.

    python benchmarks/throughput.py [CAPTURE] [--scenes 12] [--workers 1 2 4] [--rounds 1] [--set STAGE.KEY=VALUE ...] [--out FILE.json]

The scenes are copies of CAPTURE (samples/cube_and_ball by default; a video has more stages that can overlap with training) that differ in
a byte, so that none finds results of another one. "One after the other" is `e4dgs run all` for each, with all cores; a batch is
`e4dgs batch --jobs N`. Each begins with an empty workspace. Contenders run in turns; the best time of each counts. Beside the wall time
stands the processor's: on a busy machine wall times say little, and processor seconds show what a batch costs more (a process for each
stage) or less (threads that need not wait for one another).
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from e4dgs.workflows.bench.machine import machine

ROOT = Path(__file__).resolve().parents[1]
SAMPLE = ROOT / "samples" / "cube_and_ball"
SMALL = ["coarse.iterations=300", "hulls.budget=300", "fine.iterations=100", "evaluate.movie_frames=0"]
BARS = {"speedup_of_2_workers": 1.5, "speedup_of_any": 1.0}


def copies(capture: Path, count: int, folder: Path) -> list[Path]:
    """The same capture under several names, with a byte more in one file of each, so that no scene finds results of another one."""
    made = []
    for k in range(count):
        place = folder / f"scene{k:02d}{capture.suffix}"
        if capture.is_dir():
            shutil.copytree(capture, place)
            listed = sorted(place.glob("*.json")) or [file for file in sorted(place.rglob("*")) if file.is_file()]
            target = listed[0]
        else:
            shutil.copyfile(capture, place)
            target = place
        with open(target, "ab") as file:  # white space behind JSON, and what follows the end of a video, are not read
            file.write(b" " * (k + 1))
        made.append(place)
    return made


def timed(run: Callable[[], None]) -> dict[str, float]:
    load, before, started = os.getloadavg()[0], resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    run()
    seconds, after = time.perf_counter() - started, resource.getrusage(resource.RUSAGE_CHILDREN)
    used = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return {"seconds": round(seconds, 2), "processor_seconds": round(used, 2), "load_before": round(load, 2)}


def e4dgs(words: list[str], environment: dict[str, str]) -> None:
    done = subprocess.run([sys.executable, "-m", "e4dgs.workflows.cli", *words], capture_output=True, text=True, env=environment)
    if done.returncode:
        raise SystemExit(f"e4dgs {' '.join(words)}: exit code {done.returncode}\n{done.stdout[-2000:]}{done.stderr[-2000:]}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("capture", type=Path, nargs="?", default=SAMPLE)
    parser.add_argument("--scenes", type=int, default=12)
    parser.add_argument("--workers", type=int, nargs="+", default=[1, 2, 4])
    parser.add_argument("--rounds", type=int, default=1)
    parser.add_argument("--set", action="append", default=None, metavar="STAGE.KEY=VALUE")
    parser.add_argument("--out", type=Path, default=ROOT / "benchmarks" / "results" / "throughput.json")
    args = parser.parse_args()
    settings = args.set or SMALL
    words = [*(word for one in settings for word in ("--set", one)), "--device", "cpu"]
    environment = {name: value for name, value in os.environ.items() if name != "OMP_NUM_THREADS"}  # all cores, or what a batch says
    protocol = {"capture": args.capture.name, "scenes": args.scenes, "settings": settings, "rounds": args.rounds, "device": "cpu"}
    result: dict[str, Any] = {"machine": machine(), "protocol": protocol, "bars": BARS, "runs": {}}
    runs: dict[str, list[dict[str, float]]] = result["runs"]
    with tempfile.TemporaryDirectory() as folder:
        captures = copies(args.capture, args.scenes, Path(folder))

        def in_turn(workspace: Path) -> None:
            for capture in captures:
                e4dgs(["run", "all", str(capture), "--workspace", str(workspace), *words], environment)

        def batch(workspace: Path, workers: int) -> None:
            named = [str(capture) for capture in captures]
            e4dgs(["batch", *named, "--workspace", str(workspace), "--jobs", str(workers), *words], environment)

        contenders: dict[str, Callable[[Path], None]] = {"one after the other": in_turn}
        contenders |= {f"batch, {n} workers": lambda workspace, n=n: batch(workspace, n) for n in args.workers}
        for turn in range(args.rounds):
            for name, contender in contenders.items():
                workspace = Path(folder) / "workspace"
                runs.setdefault(name, []).append(timed(lambda contender=contender, workspace=workspace: contender(workspace)))
                shutil.rmtree(workspace)
                print(turn, name, json.dumps(runs[name][-1]), flush=True)
    best = {name: min(run["seconds"] for run in found) for name, found in runs.items()}
    result["speedup"] = {name: round(best["one after the other"] / seconds, 3) for name, seconds in best.items()}
    args.out.write_text(json.dumps(result, indent=1) + "\n")
    print(json.dumps(result["speedup"], indent=1))


if __name__ == "__main__":
    main()
