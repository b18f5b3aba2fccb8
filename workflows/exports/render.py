"""`e4dgs render CAPTURE`: renders the trained scene along a camera path, as a video or as pictures and depth."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.console import Console

from ...pipeline import CaptureError, Progress, SettingsError, StageError
from ..options import of_last_run
from ..results import results, trained_stage
from ..session import Options, open_session
from .trained import writing


@of_last_run("coarse")
def render(
    options: Options,
    out: Annotated[Path, typer.Option("--out", metavar="FILE.mp4|DIR", help="A video, or a folder for PNG files.")],
    path: Annotated[str, typer.Option("--path", metavar="NAME|FILE.json", help="turntable, spiral, capture, or a file.")] = "spiral",
    frames: Annotated[int | None, typer.Option("--frames", min=1, max=100_000, help="Number of pictures; 120 by default.")] = None,
    size: Annotated[
        int | None, typer.Option("--size", min=16, max=16_384, help="Longer side in px; by default that of the capture.")
    ] = None,
    time: Annotated[
        float | None, typer.Option("--time", min=0, max=1, help="Only this time, 0 to 1; by default time runs from 0 to 1.")
    ] = None,
    fps: Annotated[float, typer.Option("--fps", min=1, max=240, help="Frames per second of a video.")] = 30.0,
    depth: Annotated[bool, typer.Option("--depth", help="Write depth as EXR beside each PNG.")] = False,
) -> None:
    """Render a trained scene along a path of the camera: a video, or pictures and depth."""
    video = out.suffix.lower() == ".mp4"
    if depth and video:
        raise SettingsError("--depth: a video holds no depth; give a folder as --out")
    if out.suffix and not video and not out.is_dir():
        raise SettingsError(f"--out {out}: the file must end in .mp4; without an ending it is a folder for PNG files")
    if video and out.is_dir():
        raise SettingsError(f"--out {out}: this is a folder; name a file that ends in .mp4, or a folder without that ending")
    place = next(folder for folder in out.absolute().parents if folder.exists())
    if not place.is_dir():
        raise SettingsError(f"--out {out}: {place} is a file, not a folder; give another --out")
    if not os.access(place, os.W_OK | os.X_OK):  # the library that writes videos would say that there is no such file
        raise StageError(f"render: --out {out}: {place} cannot be written; give another --out")
    session = open_session(options)
    trained = trained_stage(session)
    found = results(session, trained)

    import torch

    from ...rasterizer import Camera
    from ...stages.artifacts.frameset import FrameSet
    from ...stages.artifacts.model import read_model
    from ...vision.images.movie import Movie, Pictures
    from .camera_path import resolve

    artifact, frame_artifact = found[trained], found["frames"]
    assert artifact is not None and frame_artifact is not None  # `results` guarantees the first, and no stage runs without the second
    capture_frames = FrameSet(frame_artifact, session.job.capture.root, found.get("poses"))
    if not len(capture_frames.train):
        raise CaptureError(f"{options.capture}: no training frame has a pose, so there is no place to look from")
    model = read_model(artifact).to(session.job.device)
    views = resolve(path, capture_frames, model, frames)
    width, height = capture_frames.width, capture_frames.height
    if size is not None:
        width, height = (max(1, round(side * size / max(capture_frames.width, capture_frames.height))) for side in (width, height))
    scale = np.diag([width / capture_frames.width, height / capture_frames.height, 1.0])  # pixel centres are at +0.5, so there is no offset
    console = Console()
    with (
        writing(out, "render"),
        Progress(len(views.time), "render", console) as bar,
        Movie(out, fps) if video else Pictures(out, depth) as target,
    ):
        for K, pose, t in zip(views.K, views.cam_from_world, views.time):
            camera = Camera(torch.tensor(scale @ K).float(), torch.tensor(pose).float(), width, height, model.near)
            frame = model.render(camera, float(t) if time is None else time)
            target.add((frame.color.clamp(0, 1) * 255).round().byte().cpu().numpy(), frame.depth.cpu().numpy().astype(np.float32))
            bar.advance(1)
    console.print(f"{len(views.time)} pictures of {width}x{height}: {out}", markup=False, highlight=False, soft_wrap=True)
