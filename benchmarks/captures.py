"""What people bring, each by `e4dgs run all CAPTURE --preset fast` and no further word: does it end well, what is said, how good is it.

    python benchmarks/captures.py SCENES [--fox DIR] [--only NAME ...] [--scratch DIR] [--out benchmarks/results/captures.json]

SCENES is the folder of captures (README, "Results"). fox is data/nerf/fox of github.com/NVlabs/instant-ngp; without --fox it is left out.
Captures are made below --scratch (`capture_kinds.py`), where each has its workspace. Rows of earlier runs in --out are kept.
"""

from __future__ import annotations

import argparse
import json
import re
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import capture_kinds as kinds
import numpy as np
from e4dgs.pipeline import Artifact, Records
from e4dgs.workflows.bench.machine import machine
from quality_rows import trimmed

Make = Callable[[Path, Path], Path]
CAPTURES: dict[str, tuple[str, Make]] = {
    "nerfies": ("Nerfies layout from the scene factory, 36 pictures of one camera", kinds.nerfies),
    "rotated-video": ("room.mp4 turned by 90 degrees by its metadata, no poses", kinds.rotated_video),
    "four-videos": ("four of stage's videos, no poses", kinds.videos_alone),
    "two-sizes": ("stage as images with transforms.json, three of eight cameras at half size", kinds.rig_of_two_sizes),
    "stage": ("eight videos and poses_bounds.npy", lambda scenes, folder: scenes / "stage"),
    "colmap": ("balloon1 as a COLMAP model with points", kinds.colmap_folder),
    "zip": ("the same in a .zip file", kinds.archived),
    "fox": ("instant-ngp's fox as shipped, 50 of 67 listed images are there", lambda fox, folder: fox),
}
COMMAND = ("run", "all", "CAPTURE", "--preset", "fast")


def measure(make: Make, scenes: Path, folder: Path) -> dict[str, Any]:
    """Make the capture, run it with `folder` as working directory, so that the workspace is in it, and write the log there."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    words = [str(make(scenes, folder)) if word == "CAPTURE" else word for word in COMMAND]
    started = time.monotonic()
    with (folder / "log").open("w") as log:
        command = [sys.executable, "-m", "e4dgs.workflows.cli", *words]
        code = subprocess.run(command, cwd=folder, stdout=log, stderr=subprocess.STDOUT).returncode
    return {"exit_code": code, "wall_seconds": round(time.monotonic() - started, 1)} | outcome(folder)


def outcome(folder: Path) -> dict[str, Any]:
    """What the log and the workspace say."""
    lines = (folder / "log").read_text().replace(f"{folder}/", "").splitlines()
    result: dict[str, Any] = {"frames": registered(folder / "e4dgs-workspace"), "said": said(lines)}
    for file in folder.glob("e4dgs-workspace/scenes/*/metrics.json"):
        result["metrics"] = trimmed(json.loads(file.read_text()))
    return result


def registered(workspace: Path) -> dict[str, int] | None:
    """Frames that were read and those of them with a pose."""
    for scene in workspace.glob("scenes/*"):
        records = {stage: Records(scene / "records").read(stage) for stage in ("frames", "poses")}
        found = {stage: Artifact(workspace / "store" / stage / record["key"]) for stage, record in records.items() if record}
        if "frames" in found:
            poses = found.get("poses", found["frames"]).read("cam_from_world")
            return {"read": len(found["frames"].attrs["names"]), "registered": int(np.isfinite(poses).all((1, 2)).sum())}
    return None


def said(lines: list[str]) -> list[str]:
    """What was said of the capture, above the plan and by the stages, and errors; without their progress."""
    heads = ("  frames: ", "  poses: ", "  flow: nothing moves", "  evaluate: ", "error: ")
    above = next((i for i, line in enumerate(lines) if line.startswith("stage ")), 0)
    told = [f"frames: {line.strip()}" for line in lines[:above] if line.startswith("  ")][1:]  # the first is of sizes
    told += [line.strip() for line in lines if line.startswith(heads)]
    return [line for line in dict.fromkeys(told) if not re.search(r" \(\d+ %\)", line)]


def table(results: dict[str, dict[str, Any]]) -> str:
    heads = ("capture", "what is special", "exit code", "wall", "registered of read", "split", "PSNR", "SSIM", "edge PSNR")
    rows = ["| " + " | ".join((*heads, "train PSNR", "Gaussians + convexes", "said")) + " |", "|" + "---|" * (len(heads) + 3)]
    for name, r in results.items():
        frames, metrics = r["frames"], r.get("metrics")
        cells = [name, CAPTURES[name][0], str(r["exit_code"]), f"{r['wall_seconds'] / 60:.1f} min, load {r['machine']['load']}"]
        cells.append(f"{frames['registered']} of {frames['read']}" if frames else "")
        splits = {split: row for split, row in (metrics["splits"] if metrics else {}).items() if row and row.get("psnr") is not None}
        held_out = [split for split in splits if split != "train"]
        cells.append(", ".join(held_out))
        for field, digits in (("psnr", 2), ("ssim", 4), ("edge_psnr", 2)):
            cells.append(", ".join(f"{splits[split][field]:.{digits}f}" for split in held_out))
        cells.append(f"{splits['train']['psnr']:.2f}" if "train" in splits else "")
        count = metrics["primitives"] if metrics else {}
        cells.append(f"{count['gaussians']} + {count['convexes']}" if count else "")
        rows.append("| " + " | ".join((*cells, "<br>".join(r["said"]).replace("|", "\\|"))) + " |")
    return "\n".join(rows)


def page(name: str, results: dict[str, dict[str, Any]]) -> str:
    intro = f"`e4dgs {' '.join(COMMAND)}` with no further word. Machine and protocol of every row: `{name}`."
    intro += " Wall times stand with the load of the machine: other programs ran beside."
    missing = ", ".join(capture for capture in CAPTURES if capture not in results)
    return f"# Captures as people bring them\n\n{intro}{f' Not measured yet: {missing}.' if missing else ''}\n\n{table(results)}\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", type=Path)
    parser.add_argument("--fox", type=Path)
    parser.add_argument("--only", nargs="+", choices=CAPTURES, default=list(CAPTURES))
    parser.add_argument("--scratch", type=Path, default=Path("e4dgs-workspace/captures"))
    parser.add_argument("--out", type=Path, default=Path(__file__).parent / "results" / "captures.json")
    args = parser.parse_args()
    results = json.loads(args.out.read_text())["results"] if args.out.is_file() else {}
    for name in args.only:
        if name == "fox" and args.fox is None:
            print("fox is left out: no --fox")
            continue
        print(f"{name} ...", flush=True)
        before = machine()
        scenes = args.fox if name == "fox" else args.scenes
        results[name] = measure(CAPTURES[name][1], scenes, args.scratch.resolve() / name) | {"machine": before}
        args.out.write_text(json.dumps({"results": results}, indent=1) + "\n")
        args.out.with_suffix(".md").write_text(page(args.out.name, results))
        print(f"{name}: exit code {results[name]['exit_code']} after {results[name]['wall_seconds']} s", flush=True)


if __name__ == "__main__":
    main()
