"""The model in a `coarse` or `fine` artifact: its arrays and its config. `training_log.py` has the record of the training."""

from __future__ import annotations

from ...pipeline import Artifact, ArtifactWriter, StageError
from ...scene.model import Model

UNITS = {"means": "world unit", "points": "world unit", "log_tau": "ln(1/world unit)", "log_kappa": "ln(1/world unit)", "quats": "w x y z"}
BESIDE = ("depth_", "seeds_")  # prefixes of the arrays that do not belong to the model


def write_model(out: ArtifactWriter, model: Model) -> None:
    """Writes the result of `Model.to_arrays` as arrays; the config and the number of primitives become attributes."""
    for name, array in model.to_arrays().items():
        out.write(name, array, unit=UNITS.get(name.split("_", 1)[1], ""))
    out.attrs["model"] = model.config
    out.attrs["primitives"] = {"gaussians": len(model.gaussians), "convexes": len(model.convexes)}


def read_model(artifact: Artifact) -> Model:
    """The model of a `coarse` or `fine` artifact. Raises StageError if another version wrote it and parts of the model are missing."""
    arrays = {name: artifact.read(name) for name in artifact.names() if not name.startswith(BESIDE)}
    try:
        return Model.from_arrays(arrays, artifact.attrs["model"])
    except KeyError as error:
        stage = artifact.provenance.get("stage", "the stage")
        raise StageError(f"{artifact.path}: another version of e4dgs wrote this model, without {error}; run {stage} again") from error
