"""The training log in a `coarse` or `fine` artifact. It contains timings, so it is not part of the content digest."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from ...pipeline import Artifact, ArtifactWriter

if TYPE_CHECKING:
    from ...scene.training.log import TrainingLog


def write_training_log(out: ArtifactWriter, log: TrainingLog) -> None:
    out.info["training"] = dict(vars(log))


def read_training_log(artifact: Artifact) -> dict[str, Any]:
    """The fields of `TrainingLog`; empty if nothing was trained."""
    return artifact.info.get("training", {})
