"""A model as `coarse` and `fine` write it: its arrays, its config, and what training did. `coarse.py` has what `coarse` adds."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from ...pipeline import Artifact, ArtifactWriter, StageError

if TYPE_CHECKING:
    from ...scene.model import Model
    from ...scene.training.log import TrainingLog

UNITS = {"means": "world unit", "points": "world unit", "log_tau": "ln(1/world unit)", "log_kappa": "ln(1/world unit)", "quats": "w x y z"}
BESIDE = ("depth_", "seeds_")  # beginnings of the names of arrays that are none of the model's


def write_model(out: ArtifactWriter, model: Model, log: TrainingLog) -> None:
    """`Model.to_arrays` as arrays, its config and the number of primitives as attributes. The training log holds timings, which are no
    content, and goes to info."""
    for name, array in model.to_arrays().items():
        out.write(name, array, unit=UNITS.get(name.split("_", 1)[1], ""))
    out.attrs["model"] = model.config
    out.attrs["primitives"] = {"gaussians": len(model.gaussians), "convexes": len(model.convexes)}
    out.info["training"] = dict(vars(log))


def read_model(artifact: Artifact) -> Model:
    """The model of a `coarse` or `fine` artifact. Raises StageError where a version wrote it that knew less of a model."""
    from ...scene.model import Model

    arrays = {name: artifact.read(name) for name in artifact.names() if not name.startswith(BESIDE)}
    try:
        return Model.from_arrays(arrays, artifact.attrs["model"])
    except KeyError as error:
        stage = artifact.provenance.get("stage", "the stage")
        raise StageError(f"{artifact.path}: another version of e4dgs wrote this model, without {error}; run {stage} again") from error


def read_training_log(artifact: Artifact) -> dict[str, Any]:
    """The fields of `TrainingLog`; empty where nothing was trained."""
    return artifact.info.get("training", {})
