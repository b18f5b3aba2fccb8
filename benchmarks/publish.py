"""Measures the rows of the pages' tables of quality, and writes these tables.

    python benchmarks/publish.py SCENES [--only ROW ...] [--seeds N] [--weights DIR] [--device cuda] [--busy] [--workspace DIR]
    python benchmarks/publish.py             writes the pages from what is kept, and marks rows that are out of date
    python benchmarks/publish.py --check     says which rows are out of date, by which stages; fails if a page is not what the results say

SCENES holds the captures named in `quality_rows.py`. Stop it whenever you like and begin again: runs are kept one by one
(results/rows/NAME.json) and are not repeated while machine, code of their stages, options and seed are the same. If only code before
training has changed, these stages run, and the row stays if they still make the same bits. A run of less than 20 minutes is repeated with
two more seeds, unless --seeds is less. It begins only on idle cores, unless --busy is given; the row says how many other programs used
meanwhile. --weights: the folder that `fetch-weights` fills, for LPIPS; without it the published weights of e4dgs[lpips], if they are there.
"""

from __future__ import annotations

import argparse
import json
import resource
import shutil
import subprocess
import sys
import time
from collections.abc import Iterable
from itertools import product
from pathlib import Path
from typing import Any

import psutil
import tables
from e4dgs.pipeline import Records
from e4dgs.workflows.bench.machine import machine
from quality_rows import CUDA, ROWS, Row, code_now, differing, keep, kept, stale, trimmed

SEEDS, SHORT = 3, 20 * 60  # seeds of a run that takes less than so many seconds
IDLE, LOOK = 0.15, 5.0  # cores that other programs may use, and the seconds over which that is seen
BEFORE_TRAINING = ("frames", "poses", "depth", "flow", "seeds")


def measure(row: Row, name: str, seed: int, capture: Path, workspace: Path, more: list[str]) -> dict[str, Any]:
    """One run in a workspace of its own, which is removed afterwards unless the run fails."""
    facts, began, before, own = machine(), time.monotonic(), busy_seconds(), children_seconds()
    run("all", row, name, seed, capture, workspace, more)
    seconds = time.monotonic() - began
    others = max(0.0, busy_seconds() - before - (children_seconds() - own)) / seconds
    metrics = trimmed(json.loads((workspace / "scenes" / name / "metrics.json").read_text()))
    ran = [stage for stage, outcome in metrics["stages"].items() if outcome["state"] != "skipped"]
    records = {stage: Records(workspace / "scenes" / name / "records").read(stage) for stage in ran}
    model = "fine" if "fine" in ran else "coarse"
    stored = sum(file.stat().st_size for file in (workspace / "store" / model / records[model]["key"]).rglob("*") if file.is_file())
    digests = code_now(row.device)
    shutil.rmtree(workspace)
    return {
        "seed": seed,
        "commit": facts["commit"],
        "code": {stage: digests[stage] for stage in ran},
        "contents": {stage: records[stage]["digest"] for stage in ran if stage in BEFORE_TRAINING},
        "machine": facts,
        "others": round(others, 2),
        "seconds": round(seconds, 1),
        "megabytes": round(stored / 1e6, 2),
        "metrics": metrics,
    }


def run(stage: str, row: Row, name: str, seed: int, capture: Path, workspace: Path, more: list[str]) -> None:
    """Runs a stage and what it needs in a workspace that is empty before."""
    shutil.rmtree(workspace, ignore_errors=True)
    workspace.mkdir(parents=True)
    command = [sys.executable, "-m", "e4dgs.workflows.cli", "run", stage, str(capture), "--workspace", str(workspace), "--name", name]
    with (workspace / "log").open("w") as log:
        command += ["--device", row.device, "--seed", str(seed), *row.options, *more]
        code = subprocess.run(command, stdout=log, stderr=subprocess.STDOUT).returncode
    if code:
        raise SystemExit(f"{name}, seed {seed}: exit code {code}\n{(workspace / 'log').read_text()[-2000:]}\nthe log is {workspace}/log")


def contents(row: Row, name: str, seed: int, capture: Path, workspace: Path, more: list[str]) -> dict[str, str]:
    """What today's code makes before training: digests of the stages' results."""
    run("seeds", row, name, seed, capture, workspace, more)
    records = {stage: Records(workspace / "scenes" / name / "records").read(stage) for stage in BEFORE_TRAINING}
    shutil.rmtree(workspace)
    return {stage: record["digest"] for stage, record in records.items() if record is not None}


def confirm(name: str, found: dict[str, Any], args: argparse.Namespace, more: list[str]) -> None:
    """Marks a row as up to date if nothing but code before training has changed, and that code makes the same bits for each of its runs."""
    row, now = ROWS[name], code_now(ROWS[name].device)
    asked = (found["capture"], found["options"]) == (row.capture, list(row.options))
    if not asked or any(not set(differing(one, now)) <= set(BEFORE_TRAINING) or not one.get("contents") for one in found["runs"]):
        return
    for one in found["runs"]:
        print(f"{name}, seed {one['seed']}: is what training begins with the same? ...", flush=True)
        if contents(row, name, one["seed"], args.scenes / row.capture, args.workspace / name, more) != one["contents"]:
            return
    for one in found["runs"]:
        one["code"] = {stage: now[stage] for stage in one["code"]}
        one["same_bits_at"] = machine()["commit"]
    keep(name, found | {"stale": None})


def busy_seconds() -> float:
    """Seconds that all cores together have worked since the machine began."""
    times = psutil.cpu_times()
    return times.user + times.system + times.nice


def children_seconds() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def fill(names: Iterable[str], args: argparse.Namespace, more: list[str]) -> None:
    """Measures what is missing: all rows once before any row again."""
    for seed, name in product(range(args.seeds), names):
        fill_seed(name, seed, args, more)


def fill_seed(name: str, seed: int, args: argparse.Namespace, more: list[str]) -> None:
    """Measures one seed of a row unless it is there, or the runs are long and there is another one. Runs of other code are thrown away."""
    row, here = ROWS[name], machine()["processor"]
    if (found := kept(name)) is not None and stale(name, found) is not None:
        confirm(name, found, args, more)
        found = kept(name)
    runs = found["runs"] if found is not None and stale(name, found) is None else []
    if any(run["machine"]["processor"] != here or (more and run["metrics"]["splits"]["train"]["lpips"] is None) for run in runs):
        runs = []  # of another machine, or without the LPIPS that can be measured now
    if seed in [run["seed"] for run in runs] or (runs and runs[0]["seconds"] >= SHORT):
        return
    if not args.busy and (busy := psutil.cpu_percent(LOOK) / 100 * (psutil.cpu_count() or 1)) > IDLE:
        raise SystemExit(f"other programs use {busy:.1f} cores; wait until they end, or measure all the same with --busy")
    print(f"{name}, seed {seed} ...", flush=True)
    runs.append(measure(row, name, seed, args.scenes / row.capture, args.workspace / name, more))
    keep(name, {"capture": row.capture, "options": list(row.options), "device": row.device, "stale": None, "runs": runs})


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", type=Path, nargs="?")
    parser.add_argument("--only", nargs="+", choices=ROWS, default=list(ROWS))
    parser.add_argument("--seeds", type=int, default=SEEDS)
    parser.add_argument("--device", choices=("cpu", CUDA), default="cpu")
    parser.add_argument("--weights", type=Path)
    parser.add_argument("--workspace", type=Path, default=Path("e4dgs-workspace/publish"))
    parser.add_argument("--busy", action="store_true")
    parser.add_argument("--check", action="store_true")
    args = parser.parse_args()
    more = ["--set", f"evaluate.lpips_weights={args.weights.resolve() / 'lpips_alex.safetensors'}"] if args.weights else []
    if args.scenes and not args.check:
        fill([name for name in args.only if ROWS[name].device == args.device], args, more)
    for name in args.only:
        row = kept(name)
        reason = "not measured yet" if row is None else stale(name, row)
        print(f"{name}: {reason or 'up to date'}")
        if row is not None and not args.check:
            keep(name, row | {"stale": reason})
    tables.write(args.check)


if __name__ == "__main__":
    main()
