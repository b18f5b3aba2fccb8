"""What `coarse` and `fine` write and read back: the model's arrays, its config, and what training did."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from ...pipeline import Artifact, ArtifactWriter, StageError

if TYPE_CHECKING:
    import numpy as np

    from ...scene.model import Model
    from ...scene.training.log import TrainingLog

UNITS = {"means": "world unit", "points": "world unit", "log_tau": "ln(1/world unit)", "log_kappa": "ln(1/world unit)", "quats": "w x y z"}


def write_training(out: ArtifactWriter, model: Model, log: TrainingLog) -> None:
    """Model to arrays and attrs["model"]; the training log to info (it holds timings, which are not content)."""
    for name, array in model.to_arrays().items():
        out.write(name, array, unit=UNITS.get(name.split("_", 1)[1], ""))
    out.attrs["model"] = model.config
    out.attrs["primitives"] = {"gaussians": len(model.gaussians), "convexes": len(model.convexes)}
    out.info["training"] = dict(vars(log))


def write_depth(out: ArtifactWriter, inverse: Mapping[int, np.ndarray]) -> None:
    """What a plane sweep found (`Swept.inverse`), for the stages that go on: each map once, and which frame has which."""
    import numpy as np

    if not inverse:
        return
    maps = {id(one): one for one in inverse.values()}
    number = {key: k for k, key in enumerate(maps)}
    out.write("depth_maps", np.stack(list(maps.values())), unit="1/world unit", doc="inverse depth of what stands still, 0 where unknown")
    of_frame = np.array([(frame, number[id(one)]) for frame, one in sorted(inverse.items())], np.int32)
    out.write("depth_of_frame", of_frame, doc="frame, and its row of depth_maps")


def read_depth(artifact: Artifact) -> dict[int, np.ndarray]:
    """Inverse of `write_depth`; empty where nothing was written."""
    if "depth_maps" not in artifact:
        return {}
    maps = list(artifact.read("depth_maps"))
    return {int(frame): maps[int(k)] for frame, k in artifact.read("depth_of_frame")}


def required(coarse: Artifact | None) -> Artifact:
    """The artifact of `coarse`; raises StageError where that was skipped."""
    if coarse is None:
        raise StageError("there is no coarse model to build on; run the stage `coarse` first")
    return coarse


def read_model(artifact: Artifact) -> Model:
    """The model of a `coarse` or `fine` artifact. Raises StageError where a version wrote it that knew less of a model."""
    from ...scene.model import Model

    arrays = {name: artifact.read(name) for name in artifact.names() if not name.startswith(("depth_", "seeds_"))}
    try:
        return Model.from_arrays(arrays, artifact.attrs["model"])
    except KeyError as error:
        stage = artifact.provenance.get("stage", "the stage")
        raise StageError(f"{artifact.path}: another version of e4dgs wrote this model, without {error}; run {stage} again") from error
