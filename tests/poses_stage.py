"""Runs the stages `frames` and `poses` on a capture, as the pipeline would, and keeps what the user saw."""

from pathlib import Path
from types import SimpleNamespace

from e4dgs.pipeline import Artifact, ArtifactWriter
from e4dgs.stages.frames import Frames, FramesSettings, recognise_for
from e4dgs.stages.frameset import FrameSet
from e4dgs.stages.poses import Poses, PosesSettings


class Progress:
    def __enter__(self):
        return self

    def __exit__(self, *_):
        return None

    def advance(self, n=1, note=""):
        pass


def run(capture_path: Path, folder: Path, **settings) -> SimpleNamespace:
    """`frames`, then `poses`; the context of `poses` with `.artifact` and `.lines` (what the user saw) added."""
    capture = recognise_for(capture_path, FramesSettings())
    lines: list[str] = []

    def context(stage: str, options, inputs):
        (folder / stage).mkdir(parents=True)
        return SimpleNamespace(
            capture=capture,
            facts=capture.facts,
            settings=options,
            inputs=inputs,
            out=ArtifactWriter(folder / stage),
            checkpoints=folder / "checkpoints",
            log=lines.append,
            progress=lambda total, label: Progress(),
        )

    first = context("frames", FramesSettings(), {})
    Frames().run(first)
    first.out.finish({})
    frames = Artifact(folder / "frames")
    second = context("poses", PosesSettings(**{"max_features": 2000, **settings}), {"frames": frames})
    second.lines = lines
    Poses().run(second)
    second.out.finish({})
    second.artifact = Artifact(folder / "poses")
    second.frames = FrameSet(frames, capture.root, second.artifact)
    return second
