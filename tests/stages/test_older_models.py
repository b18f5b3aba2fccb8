"""Models that earlier versions wrote: loaded, or refused with the reason and what to do."""

import zipfile
from pathlib import Path

import pytest
from e4dgs.pipeline import Artifact, StageError, Store
from e4dgs.stages.shared.model import read_model
from e4dgs.workflows.storage.stored import every

OLDER = Path(__file__).resolve().parents[1] / "older"


def older(name: str, folder: Path) -> Artifact:
    with zipfile.ZipFile(OLDER / f"{name}.zip") as archive:
        archive.extractall(folder)
    store = Store(folder / "store")
    (entry,) = store.entries()
    assert store.problem(*entry) == ""
    (stored,) = every(folder)
    assert ("gaussians_means", "4x3", "float32", "world unit") in stored.arrays()
    return store.open(*entry)


def test_a_model_of_coarse_9_is_loaded(tmp_path):
    model = read_model(older("coarse-9", tmp_path))
    assert (len(model.gaussians), len(model.convexes), model.motion.kind, model.sh_degree, model.near) == (4, 2, "static", 0, 0.01)
    assert "times" not in model.gaussians.parameters, "it was written for any motion, and no motion needs it here"


def test_a_model_of_coarse_1_says_that_it_must_be_trained_again(tmp_path):
    artifact = older("coarse-1", tmp_path)
    assert artifact.read("gaussians_means").shape == (4, 3), "the arrays can be read all the same"
    with pytest.raises(
        StageError, match=rf"{artifact.path}: another version of e4dgs wrote this model, without 'affine_cameras'; run coarse again"
    ):
        read_model(artifact)
