"""A trained model drawn at other image sizes than its own, against the photos resized by area.

    python benchmarks/zoom.py SCENE CAPTURE [--widths 100 200 400] [--out FILE.json]

SCENE is the folder of a finished run (<workspace>/scenes/<name>) of CAPTURE, a folder of pictures without distortion. A run with
`--set frames.max_size=400` of larger pictures can be drawn at their size, too, as large as these are.
`python benchmarks/zoom.py --boxes FOLDER` makes such a capture of 800x800 with the tests' scene factory: five boxes that turn on a slab.
"""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import replace
from pathlib import Path

import cv2
import e4dgs
import numpy as np
import torch
from e4dgs.pipeline import Records, Store
from e4dgs.scene.metrics.psnr import psnr
from e4dgs.stages.evaluate.judge import Judge
from e4dgs.stages.shared.dataset import load_frameset
from e4dgs.vision.images.pictures import composite, read_picture
from e4dgs.workflows.bench.machine import machine

sys.path.append(str(Path(__file__).resolve().parents[1] / "tests"))  # for the scene factory
STAGES = "frames", "poses"


def boxes(folder: Path) -> None:
    """A capture with hard edges in the layout of D-NeRF: 60 training, 8 validation and 12 test views of five boxes that turn."""
    from factory import Options, make, write_dnerf

    options = Options(boxes=5, spheres=0, light=0.4, times=60, val=8, test=12, width=800, height=800, fov_degrees=40.0, samples=3)
    write_dnerf(make(options), folder)


def photo(judge: Judge, capture: Path, i: int, size: tuple[int, int]) -> np.ndarray:
    """The picture of frame ``i`` as it was captured, on the background, resized by area; float32 [h, w, 3] in [0, 1]."""
    frames = judge.frames
    picture = composite(read_picture(capture, frames.files[i], frames.upright), frames.background).astype(np.float32) / 255
    return picture if size[0] == picture.shape[1] else cv2.resize(picture, size, interpolation=cv2.INTER_AREA)


def drawn(judge: Judge, capture: Path, i: int, width: int) -> tuple[np.ndarray, np.ndarray]:
    """Render and photo of frame ``i``, ``width`` pixels wide."""
    camera = judge.camera(i)
    height = round(camera.height * width / camera.width)
    K = camera.K.clone()
    K[0] *= width / camera.width
    K[1] *= height / camera.height
    color = judge.model.render(replace(camera, K=K, width=width, height=height), float(judge.frames.time[i])).color
    return color.clamp(0, 1).numpy(), photo(judge, capture, i, (width, height))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", type=Path, nargs="?")
    parser.add_argument("capture", type=Path, nargs="?")
    parser.add_argument("--boxes", type=Path, metavar="FOLDER", help="only make a capture")
    parser.add_argument("--widths", type=int, nargs="+", default=[100, 200, 400])
    parser.add_argument("--out", type=Path)
    args = parser.parse_args()
    if args.boxes:
        return boxes(args.boxes)
    if not args.capture:
        parser.error("SCENE and CAPTURE are needed, or --boxes FOLDER")
    store, records = Store(args.scene.parent.parent / "store"), Records(args.scene / "records")
    found = {stage: records.read(stage) for stage in STAGES}
    inputs = {stage: store.open(stage, r["key"]) if r and not r.get("skipped") else None for stage, r in found.items()}
    judge = Judge(e4dgs.load(args.scene, device="cpu"), load_frameset(inputs, args.capture), None, fixed=False)
    rows = {}
    with torch.no_grad():
        for split in ("val", "test"):
            chosen = [int(i) for i in getattr(judge.frames, split)]
            for width in args.widths if chosen else []:
                rows[f"{split}, {width} px"] = float(np.mean([psnr(*drawn(judge, args.capture, i, width)) for i in chosen]))
    for name, value in rows.items():
        print(f"{name}: {value:.2f} dB")
    if args.out:
        found = {"capture": args.capture.name, "antialiased": judge.model.antialiased, "psnr": rows, "machine": machine()}
        args.out.write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()
