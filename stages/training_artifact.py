"""What `coarse` and `fine` write and read back: the model's arrays, its config, and what training did."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ..pipeline import Artifact, ArtifactWriter, StageError

if TYPE_CHECKING:
    from ..scene.model import Model
    from ..scene.training.trainer import TrainingLog

UNITS = {"means": "world unit", "points": "world unit", "log_tau": "ln(1/world unit)", "log_kappa": "ln(1/world unit)", "quats": "w x y z"}


def write_training(out: ArtifactWriter, model: Model, log: TrainingLog) -> None:
    """Model to arrays and attrs["model"]; the training log to info (it holds timings, which are not content)."""
    for name, array in model.to_arrays().items():
        out.write(name, array, unit=UNITS.get(name.split("_", 1)[1], ""))
    out.attrs["model"] = model.config
    out.attrs["primitives"] = {"gaussians": len(model.gaussians), "convexes": len(model.convexes)}
    out.info["training"] = dict(vars(log))


def required(coarse: Artifact | None) -> Artifact:
    """The artifact of `coarse`; raises StageError where that was skipped."""
    if coarse is None:
        raise StageError("there is no coarse model to build on; run the stage `coarse` first")
    return coarse


def read_model(artifact: Artifact) -> Model:
    """The model of a `coarse` or `fine` artifact."""
    from ..scene.model import Model

    arrays = {name: artifact.read(name) for name in artifact.names()}
    return Model.from_arrays(arrays, artifact.attrs["model"])
