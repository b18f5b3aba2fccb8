"""Poses of structure from motion with and without the features on what moves, against the truth, over several seeds.

    python benchmarks/sfm_moving.py SCENES [--out FILE.json] [--only NAME ...] [--seeds N] [--work DIR]

SCENES is the folder of captures (../shared/scenes). Pictures: the video `room_video/room.mp4`, and crops about the middle of the pictures
of `room_mono`, which is a longer lens, in which what moves covers more (`moving`: mean share of the truth's masks, every 8th frame). The
stage `poses` runs with its default settings; features and raw matches are computed once a picture, verification and mapping for every seed.
`mapper` is the mapper's own result, `first` the first pass after the robust adjustment (what poses.moving=off gives), `second` the second
pass, `final` what the stage keeps. Percent: rms distance of camera centres after alignment, of the path's length; degrees: median angle of
rotations. Seconds: a pass is verification, mapping and adjustment, without features and matching (`prepare`); `masks` is flow and masks.
Writes JSON with protocol and machine; rows that FILE.json holds already are kept.
"""

from __future__ import annotations

import argparse
import json
import shutil
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from e4dgs.pipeline import Artifact, ArtifactWriter
from e4dgs.stages.frames.settings import FramesSettings, recognise_for
from e4dgs.stages.frames.stage import Frames
from e4dgs.stages.poses.settings import PosesSettings
from e4dgs.stages.poses.stage import Poses
from e4dgs.workflows.bench.machine import machine
from sfm_pose_error import read_truth

CROPS = {"video": None, "crop 352x198": (352, 198), "crop 288x162": (288, 162)}


class Clock:
    """Stands in for a progress bar; remembers when each phase began."""

    def __init__(self, phases: dict[str, float], label: str) -> None:
        phases.setdefault(label, time.monotonic())

    def __enter__(self) -> Clock:
        return self

    def __exit__(self, *_: object) -> None:
        return None

    def advance(self, n: int = 1, note: str = "") -> None:
        return None


def capture_of(scenes: Path, name: str, folder: Path) -> tuple[Path, float | None]:
    """The capture's path, and the share of the pictures that moves by the truth's masks; crops are written into `folder`."""
    import cv2

    size = CROPS[name]
    x, y, width, height = (0, 0, 480, 270) if size is None else (240 - size[0] // 2, 135 - size[1] // 2, *size)
    masks = [np.load(file)["object"] > 0 for file in sorted((scenes / "room_mono" / "flow").glob("flow_*.npz"))]
    share = float(np.mean([mask[y : y + height, x : x + width].mean() for mask in masks]))
    if size is None:
        return scenes / "room_video" / "room.mp4", share
    folder.mkdir(parents=True, exist_ok=True)
    for file in sorted((scenes / "room_mono" / "images").glob("*.jpg")):
        cv2.imwrite(str(folder / f"{file.stem}.png"), cv2.imread(str(file))[y : y + height, x : x + width])
    return folder, share


def context(stage: str, capture: Any, options: Any, inputs: dict[str, Any], work: Path, log: Callable[[str], None]) -> Any:
    out = work / stage
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir(parents=True)
    phases: dict[str, float] = {}
    made = {"capture": capture, "facts": capture.facts, "settings": options, "inputs": inputs, "out": ArtifactWriter(out), "phases": phases}
    return SimpleNamespace(**made, checkpoints=work / "checkpoints", log=log, progress=lambda total, label: Clock(phases, label))


def measure(capture_path: Path, truth: np.ndarray, seed: int, work: Path, raw: Path) -> dict[str, Any]:
    """One run of the stage. `raw`: a database with features and matches; made by the first run of a capture."""
    import pycolmap

    capture = recognise_for(capture_path, FramesSettings())
    first = context("frames", capture, FramesSettings(), {}, work, lambda line: None)
    Frames().run(first)
    first.out.finish({})
    second = context("poses", capture, PosesSettings(seed=seed), {"frames": Artifact(work / "frames")}, work, print)
    colmap = work / "checkpoints" / "colmap"
    prepared = raw.exists()
    if prepared and not colmap.exists():
        colmap.mkdir(parents=True)
        shutil.copy(raw, colmap / "database.db")
    started = time.monotonic()
    Poses().run(second)
    ended = time.monotonic()
    second.out.finish({})
    if not prepared:
        shutil.copy(colmap / "database.db", raw)
        with pycolmap.Database.open(raw) as database:
            database.clear_two_view_geometries()

    def error(poses: np.ndarray) -> dict[str, Any]:
        from pose_error import pose_error  # of the tests, whose folder sfm_pose_error.py adds

        seen = np.isfinite(poses).all((1, 2))
        found = pose_error(poses[seen], truth[seen])
        return {
            "registered": int(seen.sum()),
            "percent": round(found["percent"], 3),
            "degrees": round(found["rotation_degrees"], 3),
        }

    def mapped(folder: Path) -> np.ndarray:
        models = [pycolmap.Reconstruction(path) for path in sorted(folder.iterdir())]
        best = max(models, key=lambda m: (m.num_reg_images(), m.num_points3D()))
        poses = np.full((len(truth), 4, 4), np.nan)
        for i in best.reg_image_ids():
            poses[int(Path(best.image(i).name).stem)] = np.vstack([best.image(i).cam_from_world().matrix(), [0, 0, 0, 1]])
        return poses

    artifact, at = Artifact(work / "poses"), second.phases
    row: dict[str, Any] = {"seed": seed, "mapper": error(mapped(colmap / "models"))}
    with np.load(colmap / "result.npz") as arrays:
        row["first"] = error(arrays["cam_from_world"])
    if (colmap / "masked" / "result.npz").exists():
        with np.load(colmap / "masked" / "result.npz") as arrays:
            row["second"] = error(arrays["cam_from_world"])
    row["final"] = error(artifact.read("cam_from_world"))
    row |= {"moving_share": artifact.attrs["moving_share"], "second_pass": artifact.attrs["second_pass"]}
    moving = at.get("moving objects", ended)
    again = at.get("matches off moving pixels", ended)
    began = at.get("matching", started) if prepared else at.get("registering", started)
    seconds = {"first pass": moving - began, "masks": again - moving, "second pass": ended - again}
    return row | {"seconds": {name: round(value, 1) for name, value in seconds.items()}}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", type=Path)
    parser.add_argument("--out", type=Path, default=Path(__file__).parent / "results" / "sfm_moving.json")
    parser.add_argument("--only", action="append", default=[], choices=list(CROPS))
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--work", type=Path, help="a folder to keep between calls")
    args = parser.parse_args()
    truth = read_truth(args.scenes / "room_mono" / "transforms_train.json")
    document: dict[str, Any] = {"machine": machine(), "protocol": " ".join((__doc__ or "").split("\n\n")[2].split()), "pictures": {}}
    if args.out.exists():
        document["pictures"] = json.loads(args.out.read_text())["pictures"]
    with tempfile.TemporaryDirectory(prefix="e4dgs-sfm-") as temporary:
        work = args.work or Path(temporary)
        for name in args.only or CROPS:
            folder = work / name.replace(" ", "_")
            path, share = capture_of(args.scenes, name, folder / "capture")
            entry = document["pictures"].setdefault(name, {"moving": round(share or 0.0, 3), "runs": []})
            for seed in range(args.seeds):
                if any(run["seed"] == seed for run in entry["runs"]):
                    continue
                shutil.rmtree(folder / "run", ignore_errors=True)
                entry["runs"].append(measure(path, truth, seed, folder / "run", folder / "raw.db"))
                print(name, json.dumps(entry["runs"][-1]), flush=True)
                args.out.parent.mkdir(parents=True, exist_ok=True)
                args.out.write_text(json.dumps(document, indent=1) + "\n")


if __name__ == "__main__":
    main()
