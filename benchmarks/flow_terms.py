"""The flow terms of training (Table 3 of the paper), and how far rendered flow is from measured flow.

    python benchmarks/flow_terms.py SCENES [--out FILE.json] [--rows NAME ...] [--set stage.key=value ...] [--workspace DIR]

SCENES is the folder of captures. Rows: room_mono and stage (rows a, c, d and Full of Table 3 each, by `e4dgs run all`), step (time and
memory of a training step with and without the terms). --set holds for every run, for instance fewer steps; the result names them.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from e4dgs.workflows.bench.machine import kernels, machine
from e4dgs.workflows.bench.output import row_json, write
from e4dgs.workflows.bench.rows import Check, Measured, Row

NO_DATA, NO_INTERVAL = ((f"train.{term}_weight=0",) for term in ("data_flow", "interval"))
PAPER = ("train.motion=planes",)  # the paper's model; what lives for a while is steady by itself
TABLE_3 = {  # (b), convexes only, has no flow term and belongs to the table of strategies
    "a, base": (*NO_DATA, *NO_INTERVAL, "hulls.budget=0"),
    "c, edges at time steps": (*NO_INTERVAL, "hulls.budget=0"),
    "d, edges and interval": ("hulls.budget=0",),
    "Full": (),
}
MOST_PAIRS = 90  # of a capture whose rendered flow is compared
STEPS = 32  # of the step's time and memory, four rounds of every term


def cli(*words: str) -> None:
    subprocess.run([sys.executable, "-m", "e4dgs.workflows.cli", *words], check=True, capture_output=True, text=True)


def trained(capture: Path, workspace: Path, name: str, settings: tuple[str, ...]) -> dict[str, Any]:
    """metrics.json of a run."""
    options = [word for setting in (*PAPER, *settings) for word in ("--set", setting)]
    cli("run", "all", str(capture), "--workspace", str(workspace), "--name", name, *options)
    metrics: dict[str, Any] = json.loads((workspace / "scenes" / name / "metrics.json").read_text())
    return metrics


def agreement(capture: Path, workspace: Path, name: str) -> dict[str, float]:
    """Median distance in px of rendered from measured flow over edge pixels of up to `MOST_PAIRS` pairs of training frames, over those edge
    pixels that move, and of Eq. 8's difference of rendered flows at edges that move."""
    import torch
    from e4dgs.pipeline import Records, Store
    from e4dgs.scene.losses.flow_loss import rendered_flow
    from e4dgs.stages.evaluate.judge import Judge
    from e4dgs.stages.evaluate.pictures.flow import COVERED, EDGE, TRUSTED
    from e4dgs.stages.evaluate.spread import spread
    from e4dgs.stages.flow.artifact import StoredFlow
    from e4dgs.stages.shared.frameset import FrameSet
    from e4dgs.stages.shared.model import read_model

    store, records = Store(workspace / "store"), Records(workspace / "scenes" / name / "records")

    def artifact(stage: str):
        record = records.read(stage)
        return None if record is None or record.get("skipped") else store.open(stage, record["key"])

    frames = FrameSet(artifact("frames"), capture)
    judge = Judge(read_model(artifact("fine") or artifact("coarse")), frames, None, fixed=False)
    fields = StoredFlow(artifact("flow"))
    dt = 1 / max(len(np.unique(frames.time)) - 1, 1)
    everywhere, moving, steady = [], [], []
    for p in spread(range(len(fields.pairs)), MOST_PAIRS):
        first, second = fields.pairs[p]
        t, later = float(frames.time[first]), float(frames.time[second])
        camera = judge.camera(first)
        with torch.no_grad():
            flow, alpha = (x.numpy() for x in rendered_flow(judge.model, camera, t, judge.camera(second), later))
            start = min(t, 1 - 2 * dt)
            here, there = (rendered_flow(judge.model, camera, s, camera, s + dt)[0].numpy() for s in (start, start + dt))
        counts = (fields.edges(first) >= EDGE) & (fields.confidence(p) >= TRUSTED) & (alpha > COVERED)
        mask = fields.moving_pixels(first, int(frames.camera[first]))
        moves = counts & (mask > 0) if mask is not None else counts
        distance = np.linalg.norm(fields.forward(p).astype(np.float32) - flow, axis=-1)
        everywhere.append(distance[counts])
        moving.append(distance[moves])
        steady.append(np.linalg.norm(there - here, axis=-1)[moves])
    return {
        "edges": float(np.median(np.concatenate(everywhere))),
        "moving edges": float(np.median(np.concatenate(moving))),
        "unsteady": float(np.mean(np.concatenate(steady))),
    }


def table_3(capture: Path, workspace: Path, common: tuple[str, ...]) -> Measured:
    options = " with " + ", ".join(common) if common else ""
    found = Measured(
        f"{capture.name}, `e4dgs run all`{options}; test views; flow: median distance of rendered from measured flow, px, at edge pixels "
        f"(weight >= 0.5) whose flow is trusted, of up to {MOST_PAIRS} pairs of training frames, and at those that move; unsteady: mean "
        "|flow(t + dt) - flow(t)| of the rendered flow at edges that move, px",
        columns=("row", "PSNR", "SSIM", "edge PSNR", "flow at edges", "moving edges", "unsteady", "Gaussians", "convexes", "train"),
    )
    table = []
    for row, settings in TABLE_3.items():
        name = f"{capture.name}-{row.split(',')[0]}"
        metrics = trained(capture, workspace, name, (*common, *settings))
        flow, test, count = agreement(capture, workspace, name), metrics["splits"]["test"], metrics["primitives"]
        found.numbers[row] = {k: test[k] for k in ("psnr", "ssim", "edge_psnr")} | flow | count | {"seconds": metrics["train_seconds"]}
        table.append(
            (
                row,
                *(f"{test['psnr']:.2f} dB", f"{test['ssim']:.3f}", f"{test['edge_psnr']:.2f} dB"),
                *(f"{value:.2f} px" for value in flow.values()),
                *(str(count["gaussians"]), str(count["convexes"]), f"{metrics['train_seconds']:.0f} s"),
            )
        )
        print(" | ".join(table[-1]), flush=True)
        if row.startswith(("c", "d", "F")):
            found.checks.append(Check(f"{row}: rendered flow from measured, median at edges", flow["edges"], 1.0, unit="px"))
    found.table = table
    return found


CHILD = """
import json, resource, sys, time
sys.path.insert(0, sys.argv[1])
from flow_terms import steps
print(json.dumps({"ms": steps(*sys.argv[2:]), "mib": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**10}))
"""


def steps(capture: str, workspace: str, name: str, interval: str, data: str, every: str) -> float:
    """Milliseconds of a step of the trained model, mean over `STEPS` of them."""
    import time

    from e4dgs.pipeline import Records, Store
    from e4dgs.scene.losses.term import Measured
    from e4dgs.scene.motion.phases import Phase
    from e4dgs.scene.settings import TrainingSettings
    from e4dgs.scene.training.trainer import Trainer
    from e4dgs.stages.shared.dataset import load_views
    from e4dgs.stages.shared.measured import measured_flow
    from e4dgs.stages.shared.model import read_model
    from e4dgs.stages.shared.posed_frameset import PosedFrameSet

    store, records = Store(Path(workspace) / "store"), Records(Path(workspace) / "scenes" / name / "records")
    artifacts = {stage: store.open(stage, (records.read(stage) or {})["key"]) for stage in ("frames", "flow", "coarse")}
    views = load_views(PosedFrameSet(artifacts["frames"], Path(capture)), artifacts["flow"])
    options = {"interval_weight": float(interval), "data_flow_weight": float(data), "flow_every": int(every)}
    phase = Phase("deformation", 1000)
    trainer = Trainer(
        read_model(artifacts["coarse"]), views, [phase], TrainingSettings.model_validate(options), 100_000, grow=False,
        measured=Measured(measured_flow(artifacts["flow"], views)),
    )  # fmt: skip
    trainer.iteration = 400
    seconds = 0.0
    for k in range(8 + STEPS):
        started = time.perf_counter()
        trainer._step(phase, trainer.iteration)
        trainer.iteration += 1
        seconds += (time.perf_counter() - started) if k >= 8 else 0.0
    return 1e3 * seconds / STEPS


def step(capture: Path, workspace: Path, common: tuple[str, ...]) -> Measured:
    name = f"{capture.name}-d"
    if not (workspace / "scenes" / name / "metrics.json").is_file():
        trained(capture, workspace, name, (*common, *TABLE_3["d, edges and interval"]))
    found = Measured(
        f"{capture.name}, its trained coarse model, full size; mean of {STEPS} training steps and resident memory at most, a process for "
        "each row, best of two",
        columns=("terms", "every", "a step", "beside none", "memory at most"),
    )
    cases = {
        "none": ("0", "0", "8"),
        "data term": ("0", "1e-3", "8"),
        "both": ("1e-3", "1e-3", "8"),
        "both, every step": ("1e-3", "1e-3", "1"),
    }
    rows: dict[str, dict[str, float]] = {}
    for _ in range(2):
        for case, terms in cases.items():
            command = [sys.executable, "-c", CHILD, str(Path(__file__).parent), str(capture), str(workspace), name, *terms]
            got = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
            rows[case] = got if case not in rows else min(rows[case], got, key=lambda one: one["ms"])
    found.numbers = rows
    base = rows["none"]["ms"]
    found.table = [
        (case, cases[case][2] if case != "none" else "", f"{row['ms']:.1f} ms", f"{row['ms'] / base:.2f}x", f"{row['mib']:.0f} MiB")
        for case, row in rows.items()
    ]
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", type=Path)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--rows", nargs="+", choices=("room_mono", "stage", "step"), default=["room_mono", "stage", "step"])
    parser.add_argument("--set", dest="settings", action="append", default=[])
    parser.add_argument("--workspace", type=Path, help="kept; else a temporary one")
    args = parser.parse_args()
    rows: dict[str, Any] = json.loads(args.out.read_text())["rows"] if args.out and args.out.is_file() else {}
    with tempfile.TemporaryDirectory(prefix="e4dgs-flow-terms-") as temporary:
        workspace = (args.workspace or Path(temporary)).resolve()
        for name in args.rows:
            measure, capture = (step, "room_mono") if name == "step" else (table_3, name)
            found = measure((args.scenes / capture).resolve(), workspace, tuple(args.settings))
            what = "Time and memory of a training step." if name == "step" else f"Table 3 on {name}."
            rows[name] = row_json(Row(name, what, measure), found)  # type: ignore[arg-type]
            for check in found.checks:
                print(f"{name}: {check.what}: {check.value:.4g} {check.unit} (bar {check.bar}, {check.passed})", flush=True)
            for cells in found.table:
                print("  " + " | ".join(cells), flush=True)
            if args.out:
                write(args.out, {"machine": machine() | kernels(), "protocol": {"suite": "flow_terms", "judged": True}, "rows": rows})


if __name__ == "__main__":
    main()
