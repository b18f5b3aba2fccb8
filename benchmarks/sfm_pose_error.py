"""Poses of structure from motion against the truth, after aligning the camera centres by a similarity (Umeyama).

    python benchmarks/sfm_pose_error.py CAPTURE [TRUTH] [--workspace DIR] [--name NAME] [--set poses.key=value ...]

Runs the stage `poses` on CAPTURE (a video or a folder of images without poses; at once where the workspace holds the result). TRUTH is a
transforms.json (camera-to-world, OpenGL axes) of the same frames in the same order; without it only coverage and reprojection error are
printed. Writes results/sfm_<name>.json.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
from e4dgs.pipeline import Artifact, Records, Store
from e4dgs.workflows.bench.machine import machine

sys.path.append(str(Path(__file__).resolve().parents[1] / "tests"))  # for the pose error


def read_truth(path: Path) -> np.ndarray:
    """cam_from_world [F,4,4] in OpenCV axes."""
    poses = np.array([frame["transform_matrix"] for frame in json.loads(path.read_text())["frames"]], np.float64)
    poses[:, :3, 1:3] *= -1  # OpenGL looks along -z with y up
    return np.linalg.inv(poses)


def solve(capture: Path, workspace: Path, name: str, settings: list[str]) -> tuple[Artifact, float]:
    """The `poses` artifact of the capture and the seconds of the command."""
    command = [sys.executable, "-m", "e4dgs.workflows.cli", "run", "poses", str(capture), "--workspace", str(workspace), "--name", name]
    started = time.monotonic()
    done = subprocess.run([*command, *(word for setting in settings for word in ("--set", setting))])
    if done.returncode:
        raise SystemExit(done.returncode)
    record = Records(workspace / "scenes" / name / "records").read("poses")
    if record is None:
        raise SystemExit(f"{capture}: the files hold poses, so there is nothing to measure")
    return Store(workspace / "store").open("poses", record["key"]), time.monotonic() - started


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("capture", type=Path)
    parser.add_argument("truth", type=Path, nargs="?")
    parser.add_argument("--workspace", type=Path, default=Path("e4dgs-workspace"))
    parser.add_argument("--name")
    parser.add_argument("--set", dest="settings", action="append", default=[])
    args = parser.parse_args()
    name = args.name or args.capture.resolve().stem
    poses, seconds = solve(args.capture, args.workspace, name, args.settings)
    registered = poses.read("registered")
    keys = ("registered", "total", "mean_reprojection_error", "mean_track_length", "camera_model", "matcher", "mapper")
    result: dict[str, object] = {"seconds": round(seconds, 1), **{key: poses.attrs[key] for key in keys}}
    if args.truth is not None:
        from pose_error import pose_error

        truth = read_truth(args.truth)
        if len(truth) != len(registered):
            raise SystemExit(f"{args.truth}: {len(truth)} poses for {len(registered)} frames; the truth must be of the same frames")
        result["pose_error"] = pose_error(poses.read("cam_from_world")[registered], truth[registered])
    print(json.dumps(result, indent=2))
    out = Path(__file__).parent / "results" / f"sfm_{name}.json"
    out.parent.mkdir(exist_ok=True)
    document = {"machine": machine(), "capture": args.capture.name, "settings": args.settings, **result}
    out.write_text(json.dumps(document, indent=2) + "\n")


if __name__ == "__main__":
    main()
