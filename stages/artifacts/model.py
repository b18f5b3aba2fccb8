"""A model as `coarse` and `fine` write it: its arrays and its config. What training did is in `training_log.py`."""

from __future__ import annotations

from ...pipeline import Artifact, ArtifactWriter, StageError
from ...scene.model import Model

UNITS = {"means": "world unit", "points": "world unit", "log_tau": "ln(1/world unit)", "log_kappa": "ln(1/world unit)", "quats": "w x y z"}
BESIDE = ("depth_", "seeds_")  # beginnings of the names of arrays that are none of the model's


def write_model(out: ArtifactWriter, model: Model) -> None:
    """`Model.to_arrays` as arrays, its config and the number of primitives as attributes."""
    for name, array in model.to_arrays().items():
        out.write(name, array, unit=UNITS.get(name.split("_", 1)[1], ""))
    out.attrs["model"] = model.config
    out.attrs["primitives"] = {"gaussians": len(model.gaussians), "convexes": len(model.convexes)}


def read_model(artifact: Artifact) -> Model:
    """The model of a `coarse` or `fine` artifact. Raises StageError where a version wrote it that knew less of a model."""
    arrays = {name: artifact.read(name) for name in artifact.names() if not name.startswith(BESIDE)}
    try:
        return Model.from_arrays(arrays, artifact.attrs["model"])
    except KeyError as error:
        stage = artifact.provenance.get("stage", "the stage")
        raise StageError(f"{artifact.path}: another version of e4dgs wrote this model, without {error}; run {stage} again") from error
