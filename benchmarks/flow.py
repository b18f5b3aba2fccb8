"""Measured flow: error against truth, time, memory, of every method.

    python benchmarks/flow.py SCENES --weights DIR [--out FILE.json] [--rows NAME ...]

SCENES is the folder of captures (../shared/scenes; RubberWhale is looked for in ../flow/rubberwhale beside it). DIR holds
raft_{small,sintel,kitti}.safetensors; without it only DIS is measured. Rows: rubberwhale, room, factory, memory, stage.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from bench_rows.curves import Curve, Plotted
from e4dgs.vision.flow.method import Dis, FlowMethod, RaftFlow
from e4dgs.vision.flow.two_way import both_ways, trusted
from e4dgs.workflows.bench.machine import kernels, machine
from e4dgs.workflows.bench.output import row_json, write
from e4dgs.workflows.bench.rows import Check, Measured, Row

sys.path.append(str(Path(__file__).resolve().parents[1] / "tests"))  # for the scene factory and the reader of .flo files

NETWORKS = ("small", "sintel", "kitti")
PUBLISHED = {"sintel": (0.177, 0.005), "small": (0.320, 0.01), "kitti": (0.453, 0.01)}  # px on RubberWhale, as anchors
FACTORY_TIMES = 24
JUMP = 0.5  # px of true flow from one pixel to the next that makes an outline; its pixels are those within 2 px of one


def read(path: Path) -> np.ndarray:
    image = cv2.imread(str(path), cv2.IMREAD_COLOR)
    if image is None:
        raise SystemExit(f"{path}: cannot be read as a picture")
    return cv2.cvtColor(image, cv2.COLOR_BGR2RGB)


def methods(weights: Path | None, networks: tuple[str, ...] = NETWORKS, **options: float) -> dict[str, FlowMethod]:
    found: dict[str, FlowMethod] = {f"dis-{preset}": Dis(preset) for preset in ("ultrafast", "fast", "medium")}  # type: ignore[arg-type]
    if weights is not None:
        from e4dgs.vision.flow.raft import Raft

        for name in networks:
            found[f"raft-{name}"] = RaftFlow(Raft.load(weights / f"raft_{name}.safetensors"), **options)  # type: ignore[arg-type]
    return found


def distance(flow: np.ndarray, truth: np.ndarray, where: np.ndarray) -> float:
    return float(np.linalg.norm(flow.astype(np.float64) - truth, axis=-1)[where].mean())


def rubberwhale(scenes: Path, weights: Path | None) -> Measured:
    """End-point error on Middlebury's RubberWhale, 20 updates."""
    folder = scenes.parent / "flow" / "rubberwhale"
    first, second = (read(folder / f"RubberWhale{k}.png") for k in (1, 2))
    from flo_files import read_flo

    truth = read_flo(folder / "RubberWhale.flo")
    known = (np.abs(truth) < 1e9).all(-1)
    size = f"{first.shape[1]}x{first.shape[0]}"
    found = Measured(f"{size}, mean over the {known.mean():.1%} of the pixels whose flow is known; RAFT: 20 updates")
    for name, method in methods(weights, iterations=20).items():
        error = distance(method.flow(method.prepare(first), method.prepare(second)), truth, known)
        found.numbers[name] = error
        if (published := PUBLISHED.get(name.removeprefix("raft-"))) is not None:
            off = abs(error - published[0])
            found.checks.append(Check(f"{name}, off from {published[0]} px", off, published[1], unit="px", note=f"{error:.4f} px"))
        else:
            found.checks.append(Check(f"{name}, error", error, 0.23 if name == "dis-medium" else None, unit="px"))
    return found


def truths(room: Path) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]]:
    """Both pictures, true flow [H, W, 2], what stays visible [H, W], of every pair that has a truth."""
    pictures = sorted((room / "images").iterdir())
    for path in sorted((room / "flow").glob("flow_*.npz")):
        with np.load(path, allow_pickle=False) as data:
            i = int(path.stem.split("_")[1])
            yield read(pictures[i]), read(pictures[i + 1]), data["flow"].astype(np.float64), data["visible"].astype(bool)


def at_outlines(truth: np.ndarray) -> np.ndarray:
    jump = np.sqrt(sum(np.square(slope).sum(-1) for slope in np.gradient(truth, axis=(0, 1)))) > JUMP
    return cv2.dilate(jump.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0


def variants(weights: Path | None) -> dict[str, list[tuple[str, Callable[[int | None], FlowMethod]]]]:
    """Curves by label: the points of each, as a name and what makes the method for a longest side."""
    found: dict[str, list[tuple[str, Callable[[int | None], FlowMethod]]]] = {
        "dis": [(preset, partial(Dis, preset)) for preset in ("ultrafast", "fast", "medium")]  # type: ignore[arg-type]
    }
    if weights is not None:
        from e4dgs.vision.flow.raft import Raft

        for name in NETWORKS:
            network = Raft.load(weights / f"raft_{name}.safetensors")
            steps = [(4, 0.0), (8, 0.0), (12, 0.0), (20, 0.0), (20, 0.05)]
            for n, t in steps:
                point = f"{n} updates" + (f", stop at {t} px" if t else "")
                found.setdefault(f"raft-{name}", []).append((point, partial(RaftFlow, network, n, t)))
    return found


def room(scenes: Path, weights: Path | None) -> Measured:
    """Error, hidden pixels, and time on room_mono, by method, updates and size."""
    found = curves(list(truths(scenes / "room_mono")), weights)
    for label in ("dis, medium", "raft-small, 20 updates, stop at 0.05 px", "raft-sintel, 20 updates, stop at 0.05 px"):
        if (values := found.numbers.get(f"{label}/full")) is not None:
            for what, value in zip(("precision", "recall"), values[3:5]):
                found.checks.append(Check(f"{label}: {what} of what is hidden", float(value), 0.8, "above", unit=""))
    return found


def factory(scenes: Path, weights: Path | None) -> Measured:
    """The same on rendered boxes and balls that move, turn, squash and hide one another before a moving camera."""
    from factory import Options, make, optical_flow, render, to_uint8

    synthetic = make(
        Options(backdrop="room", rig="path", boxes=2, spheres=2, deform=0.3, times=FACTORY_TIMES, width=320, height=240, fov_degrees=60.0)
    )
    pictures = [np.ascontiguousarray(to_uint8(render(synthetic.scene, v.camera, v.time).image)[..., :3]) for v in synthetic.views]
    cases = []
    for k in range(0, FACTORY_TIMES - 1, 4):
        first, second = synthetic.views[k : k + 2]
        exact = optical_flow(synthetic.scene, first.camera, first.time, second.time, second.camera)
        cases.append((pictures[k], pictures[k + 1], exact.flow, exact.visible))
    return curves(cases, weights)


def curves(cases: list[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]], weights: Path | None) -> Plotted:
    """Error against time of every method on pairs as `truths` yields them."""
    import torch

    height, width = cases[0][0].shape[:2]
    columns = ("method", "size", "error, visible", "at outlines", "hidden", "precision", "recall", "s a pair")
    found = Plotted(
        f"{len(cases)} pairs {width}x{height} with exact flow, px; outlines: visible pixels within 2 px of a jump of {JUMP} px; "
        "precision and recall of the pixels said to be hidden; seconds for both directions on one thread, pictures prepared",
        columns=columns,
    )
    cv2.setNumThreads(1)
    torch.set_num_threads(1)
    table: list[tuple[str, ...]] = []
    for label, points in variants(weights).items():
        for size in (None, width // 2):
            name_of_curve = f"{label}{'' if size is None else ', half size'}"
            curve = Curve("time", name_of_curve, [], [], "s a pair, one thread", "mean distance from the truth, px")
            for name, make in points:
                method, sums, seconds = make(size), np.zeros(6), []
                for first, second, truth, visible in cases:
                    a, b = method.prepare(first), method.prepare(second)
                    started = time.perf_counter()
                    pair = trusted(*both_ways(method, a, b))
                    seconds.append(time.perf_counter() - started)
                    said = _said(pair.forward, pair.backward)
                    outline = at_outlines(truth) & visible
                    errors = [distance(pair.forward, truth, where) for where in (visible, outline, ~visible)]
                    sums += [*errors, (said & ~visible).sum(), said.sum(), (~visible).sum()]
                *errors, both, positive, hidden = sums
                means = [e / len(cases) for e in errors]
                best = float(np.median(seconds))
                table.append((
                    f"{label}, {name}", "full" if size is None else "half", *(f"{e:.3f}" for e in means),
                    f"{both / positive:.2f}", f"{both / hidden:.2f}", f"{best:.2f}",
                ))  # fmt: skip
                found.numbers["/".join(table[-1][:2])] = [float(v) for v in (*means, both / positive, both / hidden, best)]
                curve.x.append(best)
                curve.y.append(means[0])
                print("  ".join(table[-1]), flush=True)
            curve.x, curve.y = map(list, zip(*sorted(zip(curve.x, curve.y))))
            found.curves.append(curve)
    found.table = table
    return found


def _said(forward: np.ndarray, backward: np.ndarray) -> np.ndarray:
    from e4dgs.vision.flow.two_way import occluded

    return occluded(forward, backward)


CHILD = """
import resource, sys
import numpy as np
sys.path.insert(0, sys.argv[3])
from flow import methods
from pathlib import Path
name = sys.argv[1]
weights = Path(sys.argv[2]) if sys.argv[2] else None
picture = np.random.default_rng(0).integers(0, 256, (1080, 1920, 3), dtype=np.uint8)
method = methods(weights, tuple(n for n in ("small", "sintel") if name.endswith(n)), iterations=2)[name]
method.flow(method.prepare(picture), method.prepare(np.roll(picture, 8, 1)))
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20)
"""


def memory(scenes: Path, weights: Path | None) -> Measured:
    """Peak memory of one flow at 1920x1080, full size."""
    found = Measured(
        "one flow at 1920x1080 in a process of its own, nothing scaled down, 2 updates (more take no more); resident memory at most"
    )
    for name in ("dis-medium", *(("raft-small", "raft-sintel") if weights is not None else ())):
        command = [sys.executable, "-c", CHILD, name, str(weights or ""), str(Path(__file__).parent)]
        done = subprocess.run(command, capture_output=True, text=True, check=True)
        found.checks.append(Check(name, float(done.stdout), 3.0, unit="GiB"))
    return found


def stage(scenes: Path, weights: Path | None) -> Measured:
    """The whole stage on room_mono, and what the plan said before."""
    capture, bars = scenes / "room_mono", {"dis": 15.0, "raft-small": 360.0}
    found = Measured("`e4dgs run flow`, 90 frames 480x270, 89 pairs both ways, all threads; seconds of the command, frames cached")
    for method, bar in bars.items():
        if method != "dis" and weights is None:
            continue
        options = ["--set", f"flow.method={method}"]
        options += ["--set", f"flow.weights={weights / 'raft_small.safetensors'}"] if weights is not None and method != "dis" else []
        with tempfile.TemporaryDirectory() as folder:
            base = [sys.executable, "-m", "e4dgs.workflows.cli"]
            where = [str(capture), "--workspace", folder, *options]
            plan = json.loads(subprocess.run([*base, "plan", *where, "--json"], capture_output=True, text=True, check=True).stdout)
            estimate = next(row["estimate_seconds"] for row in plan["stages"] if row["stage"] == "flow")
            subprocess.run([*base, "run", "frames", *where], capture_output=True, check=True)
            started = time.monotonic()
            subprocess.run([*base, "run", "flow", *where], capture_output=True, check=True)
            seconds = time.monotonic() - started
        found.checks += [
            Check(f"{method}, the stage", seconds, bar, unit="s"),
            Check(f"{method}, the estimate is off by", abs(estimate / seconds - 1), 0.3, unit="", note=f"{estimate:.0f} s"),
        ]
    return found


ROWS = (rubberwhale, room, factory, memory, stage)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", type=Path)
    parser.add_argument("--weights", type=Path)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--rows", nargs="+", choices=[row.__name__ for row in ROWS])
    args = parser.parse_args()
    found: dict[str, Any] = json.loads(args.out.read_text())["rows"] if args.rows and args.out and args.out.is_file() else {}
    for row in ROWS:
        if args.rows and row.__name__ not in args.rows:
            continue
        measured = row(args.scenes.resolve(), args.weights)
        found[row.__name__] = row_json(Row(row.__name__, row.__doc__ or "", row), measured)  # type: ignore[arg-type]
        for check in measured.checks:
            print(
                f"{row.__name__}: {check.what}: {check.value:.4g} {check.unit} (bar {check.bar}, {check.passed}) {check.note}", flush=True
            )
    if args.out:
        write(args.out, {"machine": machine() | kernels(), "protocol": {"suite": "flow", "judged": True}, "rows": found})


if __name__ == "__main__":
    main()
