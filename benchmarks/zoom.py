"""A trained model drawn at other image sizes than its own, against the photos resized by area.

    python benchmarks/zoom.py SCENE CAPTURE [--sizes 1 2 4] [--out FILE.json]

SCENE is the folder of a finished run (<workspace>/scenes/<name>) of CAPTURE. Sizes are divisors of the capture's own size.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from pathlib import Path

import cv2
import e4dgs
import numpy as np
import torch
from e4dgs.pipeline import Records, Store
from e4dgs.scene.metrics.psnr import psnr
from e4dgs.stages.artifacts.dataset import load_frameset
from e4dgs.stages.evaluation.judge import Judge
from e4dgs.workflows.bench.machine import machine

STAGES = "frames", "poses"


def scaled(judge: Judge, i: int, size: int) -> tuple[np.ndarray, np.ndarray]:
    """Render and photo of frame ``i`` at 1/``size`` of the size, float32 [h, w, 3] in [0, 1]."""
    camera = judge.camera(i)
    width, height = camera.width // size, camera.height // size
    K = camera.K.clone()
    K[0] *= width / camera.width
    K[1] *= height / camera.height
    color = judge.model.render(replace(camera, K=K, width=width, height=height), float(judge.frames.time[i])).color
    photo = judge.frames.composited(i).astype(np.float32) / 255
    return color.clamp(0, 1).numpy(), photo if size == 1 else cv2.resize(photo, (width, height), interpolation=cv2.INTER_AREA)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", type=Path)
    parser.add_argument("capture", type=Path)
    parser.add_argument("--sizes", type=int, nargs="+", default=[1, 2, 4])
    parser.add_argument("--out", type=Path)
    args = parser.parse_args()
    store, records = Store(args.scene.parent.parent / "store"), Records(args.scene / "records")
    found = {stage: records.read(stage) for stage in STAGES}
    inputs = {stage: store.open(stage, r["key"]) if r and not r.get("skipped") else None for stage, r in found.items()}
    judge = Judge(e4dgs.load(args.scene, device="cpu"), load_frameset(inputs, args.capture), None, fixed=False)
    rows = {}
    with torch.no_grad():
        for split in ("val", "test"):
            chosen = [int(i) for i in getattr(judge.frames, split)]
            for size in args.sizes if chosen else []:
                rows[f"{split}, 1/{size}"] = float(np.mean([psnr(*scaled(judge, i, size)) for i in chosen]))
    for name, value in rows.items():
        print(f"{name}: {value:.2f} dB")
    if args.out:
        found = {"capture": args.capture.name, "antialiased": judge.model.antialiased, "psnr": rows, "machine": machine()}
        args.out.write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()
