"""Runs single stages as the pipeline would, and keeps what the user saw."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from e4dgs.pipeline import Artifact, ArtifactWriter, Capture, Context, Progress, Settings, Stage
from e4dgs.stages.frames.settings import FramesSettings, recognise_for
from e4dgs.stages.frames.stage import Frames
from e4dgs.stages.poses.settings import PosesSettings
from e4dgs.stages.poses.stage import Poses


@dataclass(frozen=True)
class Ran:
    """artifact: what a stage wrote. context: what it was given. lines: what the user saw."""

    artifact: Artifact
    context: Context
    lines: list[str]


def run_stage(
    stage: Stage, capture: Capture, folder: Path, settings: Settings, inputs: Mapping[str, Artifact | None] = {}, device: str = "cpu"
) -> Ran:
    """`stage` alone. Its artifact goes to `folder`/NAME, which must not exist, and what survives a kill to
    `folder`/checkpoints/NAME, where another run finds it."""
    out, lines = folder / stage.name, []
    out.mkdir(parents=True)
    checkpoints = folder / "checkpoints" / stage.name
    checkpoints.mkdir(parents=True, exist_ok=True)
    context = Context(capture, capture.facts, settings, inputs, ArtifactWriter(out), checkpoints, device, lines.append, Progress)
    stage.run(context)
    context.out.finish({})
    return Ran(Artifact(out), context, lines)


def run_frames(path: Path, folder: Path, **settings) -> Ran:
    """`frames` on the capture at `path`; `.context.capture` is what it was recognised as."""
    options = FramesSettings(**settings)
    return run_stage(Frames(), recognise_for(path, options), folder, options)


def run_poses(path: Path, folder: Path, **settings) -> Ran:
    """`frames`, then `poses` with few features; the lines of both."""
    frames = run_frames(path, folder)
    options = PosesSettings(**{"max_features": 2000, **settings})
    poses = run_stage(Poses(), frames.context.capture, folder, options, {"frames": frames.artifact})
    return replace(poses, lines=frames.lines + poses.lines)
