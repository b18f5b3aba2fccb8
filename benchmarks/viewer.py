"""How many pictures a second the viewer draws: while the camera and the time move, of the size that it chooses, and at full size; and how
long `e4dgs render` takes for a video.

    python benchmarks/viewer.py CAPTURE [--workspace DIR] [--name NAME] [--set stage.key=value ...] [--size 400] [--pictures 60]
                                [--frames 120] [--out FILE.json]

The words that made the run (--workspace, --name, --preset, --set, --device) find its model in the store; nothing is trained.

Draws what `e4dgs view` would draw for a window of --size x --size px, the JPEG for the browser included, on a turntable through the scene:
of the size that the viewer's own rule gives, once it has settled, then at full size with the camera still and with it in motion. Prints
medians; processor time stands beside the time that went by, and where the two differ, the machine was busy with something else.
The video is that of `e4dgs render CAPTURE --path turntable --frames 120 --size 400 --out FILE.mp4`, the whole command from start to end.
"""

from __future__ import annotations

import argparse
import io
import json
import resource
import shlex
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch
from e4dgs.rasterizer import Camera
from e4dgs.scene.model import Model
from e4dgs.stages.exports.camera_path import CameraPath, named_path
from e4dgs.stages.shared.posed_frameset import PosedFrameSet
from e4dgs.workflows.bench.machine import machine
from e4dgs.workflows.results import words_of
from e4dgs.workflows.session import Choice, Options, open_session
from e4dgs.workflows.view.looks import picture
from e4dgs.workflows.view.server import FIRST_SCALE, QUALITY, next_scale
from e4dgs.workflows.view.source import Source
from PIL import Image

BARS = {"moving": 15.0, "full": 5.0}  # pictures a second, lego at 400x400 on two cores
RENDER_BAR = 60.0  # s for a video of 120 frames, lego at 400x400 on two cores


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("capture", type=Path)
    parser.add_argument("--workspace", type=Path, default=Path("e4dgs-workspace"))
    parser.add_argument("--name", help="of the scene in the workspace, where the run was given one")
    parser.add_argument("--set", action="append", default=[], dest="assignments")
    parser.add_argument("--preset", default="default")
    parser.add_argument("--device", default="auto")
    parser.add_argument("--size", type=int, default=400)
    parser.add_argument("--pictures", type=int, default=60)
    parser.add_argument("--frames", type=int, default=120, help="of the video")
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    choice = Choice(arguments.preset, tuple(arguments.assignments), arguments.device)
    options = Options(arguments.capture, arguments.workspace, choice, arguments.name)
    session = open_session(options)
    source = Source(session)
    found, artifacts = source.newest(), source.frames()
    if found is None or artifacts is None:
        raise source.missing()
    frames = PosedFrameSet(artifacts[0], session.job.capture.root, artifacts[1])
    path = named_path("turntable", frames, found.model, arguments.pictures)
    result = measured(found.model, frames, path, arguments.size)
    result["render"] = rendered(options, arguments.frames, arguments.size)
    result |= {"capture": session.scene.name, "model": found.title, "size": arguments.size, "machine": machine()}
    for name, row in result["rows"].items():
        print(f"{name:28} {row['per_second']:6.1f} a second ({row['per_second_cpu']:.1f} by processor time), {row['width']} px wide")
    print(f"bars for lego at 400 px on two cores: {BARS['moving']:g} while moving, {BARS['full']:g} at full size")
    video = result["render"]
    print(
        f"a video of {video['frames']} frames: {video['seconds']:.1f} s ({video['seconds_cpu']:.1f} s of processors); bar {RENDER_BAR:g} s"
    )
    if arguments.out:
        arguments.out.write_text(json.dumps(result, indent=1) + "\n")
    return 0


def measured(model: Model, frames: PosedFrameSet, path: CameraPath, size: int) -> dict[str, Any]:
    """Rows of pictures a second: "rows" {name: {per_second, per_second_cpu, width}}."""
    assert frames.K is not None
    focal = float(frames.K[frames.train[0], 0, 0]) / frames.width * size

    def draw(k: int, scale: float, moving: bool) -> tuple[float, float]:
        """Seconds that went by, and of the processor a core, of one picture."""
        width = max(round(scale * size), 8)
        K = torch.tensor([[scale * focal, 0, width / 2], [0, scale * focal, width / 2], [0, 0, 1]], dtype=torch.float32)
        camera = Camera(K, torch.tensor(path.cam_from_world[k]).float(), width, width, model.near)
        wall, cpu = time.perf_counter(), time.process_time()
        shown = picture(model, camera, float(path.time[k]) if moving else 0.5)
        Image.fromarray(shown).save(io.BytesIO(), "JPEG", quality=QUALITY[not moving])
        return time.perf_counter() - wall, (time.process_time() - cpu) / torch.get_num_threads()

    count = len(path.time)
    draw(0, 1.0, False)  # the first one compiles and loads
    scale, moving = FIRST_SCALE, []
    for k in range(count):
        seconds, cpu = draw(k, scale, True)
        moving.append((seconds, cpu, scale))
        scale = next_scale(scale, seconds)
    moving = moving[count // 2 :]  # it has settled
    still = [(*draw(0, 1.0, False), 1.0) for _ in range(max(count // 4, 3))]
    turning = [(*draw(k, 1.0, True), 1.0) for k in range(0, count, 4)]
    rows = {"moving, size adapts": moving, "full size, at rest": still, "full size, moving": turning}
    return {"rows": {name: _row(times, size) for name, times in rows.items()}}


def rendered(options: Options, frames: int, size: int) -> dict[str, Any]:
    """`e4dgs render` in a process of its own: `seconds` that went by, `seconds_cpu` of all processors, `command` by the capture's name, and
    `passed`, whether it kept within the bar."""
    asked = ["--path", "turntable", "--frames", str(frames), "--size", str(size), "--out"]
    words = ["render", *words_of(options), *asked]
    with tempfile.TemporaryDirectory() as folder:
        before, began = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
        subprocess.run([sys.executable, "-m", "e4dgs.workflows.cli", *words, f"{folder}/video.mp4"], check=True)
        seconds, after = time.perf_counter() - began, resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    result = {"frames": frames, "seconds": round(seconds, 2), "seconds_cpu": round(cpu, 2), "bar_seconds": RENDER_BAR}
    return result | {"passed": seconds <= RENDER_BAR, "command": shlex.join(["e4dgs", "render", options.capture.name, *asked, "video.mp4"])}


def _row(times: list[tuple[float, float, float]], size: int) -> dict[str, float]:
    of: Callable[[int], float] = lambda part: statistics.median(row[part] for row in times)  # noqa: E731
    return {"per_second": 1 / of(0), "per_second_cpu": 1 / max(of(1), 1e-9), "width": round(of(2) * size)}


if __name__ == "__main__":
    sys.exit(main())
