"""Quality and run time on real captures: `e4dgs run all` on each, then a table of what metrics.json says.

    python benchmarks/quality.py SCENES [--only lego robot] [--workspace DIR] [--out benchmarks/results/quality.json]
    python benchmarks/quality.py SCENES --device cuda          results go to quality_cuda.json

SCENES is a folder with the captures named in CASES below (see README, "Results"). Every case is a fresh run in its own workspace
unless --keep is given. Results of earlier cases in --out are kept, so cases can be measured one at a time; a row that says "stale" was
measured before a change that touches it.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
import time
from pathlib import Path

from e4dgs.workflows.bench.machine import machine

CASES: dict[str, tuple[str, list[str]]] = {
    "lego": ("lego", []),
    "lego-fast": ("lego", ["--preset", "fast"]),
    "robot": ("robot", []),
    "basketball": ("basketball", []),
    "stage": ("stage", []),
    "balloon1": ("balloon1", []),
    "room-video": ("room_video/room.mp4", []),
    "room-mono": ("room_mono", []),
    "dog-gooses": ("dog_gooses/dog-gooses.mp4", []),
    "sceaux-static": ("sceaux/images", ["--static", "--set", "frames.max_size=708"]),
}


def measure(name: str, scenes: Path, workspace: Path, device: str) -> dict[str, object]:
    capture, options = CASES[name]
    command = [sys.executable, "-m", "e4dgs.workflows.cli", "run", "all", str(scenes / capture), "--workspace", str(workspace)]
    command += ["--device", device]
    started = time.monotonic()
    done = subprocess.run([*command, "--name", name, *options], text=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
    seconds = time.monotonic() - started
    (workspace / f"{name}.log").write_text(done.stdout)
    if done.returncode:
        print(done.stdout[-3000:])
        raise SystemExit(f"{name}: exit code {done.returncode}; the log is {workspace / f'{name}.log'}")
    again = time.monotonic()
    subprocess.run([*command, "--name", name, *options], check=True, capture_output=True)
    cached = time.monotonic() - again
    metrics = json.loads((workspace / "scenes" / name / "metrics.json").read_text())
    return {"options": options, "wall_seconds": round(seconds, 1), "cached_seconds": round(cached, 2), "metrics": trimmed(metrics)}


def trimmed(metrics: dict) -> dict:
    """Without the rows of each view and of each pair of times, which the report keeps."""
    splits = {name: {k: v for k, v in split.items() if k != "per_view"} for name, split in metrics["splits"].items()}
    flicker = {k: v for k, v in (metrics.get("flicker") or {}).items() if k != "per_pair"}
    return metrics | {"splits": splits, "flicker": flicker or None}


def table(results: dict[str, dict]) -> str:
    rows = ["| capture | wall | train | again | split | PSNR | SSIM | edge PSNR | Gaussians + convexes | render |", "|" + "---|" * 10]
    for name, r in results.items():
        m = r["metrics"]
        count = m["primitives"]
        again = "-" if r["cached_seconds"] is None else f"{r['cached_seconds']:.1f} s"
        title = " ".join([name, *r["options"], *(["(stale)"] if r.get("stale") else [])])
        for split, s in m["splits"].items():
            if not s or s.get("psnr") is None:
                continue
            minutes = f"{r['wall_seconds'] / 60:.1f} min | {m['train_seconds'] / 60:.1f} min"
            rows.append(
                f"| {title} | {minutes} | {again} | {split} "
                f"| {s['psnr']:.2f} | {s['ssim']:.4f} | {s['edge_psnr']:.2f} | {count['gaussians']} + {count['convexes']} "
                f"| {m['render_fps']:.1f} fps |"
            )
    return "\n".join(rows)


def page(name: str, results: dict[str, dict]) -> str:
    intro = f"Machine and protocol of every row: `{name}`. Stale rows were measured before a change that touches them."
    return f"# Quality and run time\n\n{intro}\n\n{table(results)}\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", type=Path)
    parser.add_argument("--only", nargs="+", choices=CASES, default=list(CASES))
    parser.add_argument("--workspace", type=Path, default=Path("e4dgs-workspace/quality"))
    parser.add_argument("--device", choices=("cpu", "cuda"), default="cpu")
    parser.add_argument("--out", type=Path, help="default: results/quality.json beside this file, quality_cuda.json with --device cuda")
    parser.add_argument("--keep", action="store_true", help="reuse what the workspace already holds")
    args = parser.parse_args()
    out: Path = args.out or Path(__file__).parent / "results" / ("quality.json" if args.device == "cpu" else "quality_cuda.json")
    results = json.loads(out.read_text())["results"] if out.is_file() else {}
    for name in args.only:
        workspace = args.workspace / name
        if workspace.exists() and not args.keep:
            shutil.rmtree(workspace)
        workspace.mkdir(parents=True, exist_ok=True)
        print(f"{name} ...", flush=True)
        results[name] = measure(name, args.scenes, workspace, args.device) | {"machine": machine()}
        out.parent.mkdir(parents=True, exist_ok=True)
        out.write_text(json.dumps({"results": results}, indent=1) + "\n")
        out.with_suffix(".md").write_text(page(out.name, results))
        print(table({name: results[name]}), flush=True)


if __name__ == "__main__":
    main()
