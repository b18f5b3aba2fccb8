"""`fine` grows only with the joint strategy, and then as `coarse` was told: it offers no settings of its own for that."""

import numpy as np
import pytest
from e4dgs.pipeline import Artifact, ArtifactWriter, SettingsError, build_settings
from e4dgs.scene.settings import GrowthSettings, TrainingSettings
from e4dgs.stages.artifacts.coarse import StoredCoarse
from e4dgs.stages.coarse import CoarseSettings
from e4dgs.stages.fine import FineSettings
from e4dgs.stages.training.fine import training_settings

CLASSES = {"coarse": CoarseSettings, "fine": FineSettings}
TOLD = GrowthSettings(budget=700, open_until=0.2, hidden=0.0)


@pytest.mark.parametrize("name", GrowthSettings.model_fields)
def test_growth_is_set_for_coarse_alone(name):
    assert getattr(build_settings(CLASSES, [(f"coarse.{name}", "0")])["coarse"], name) == 0
    with pytest.raises(SettingsError, match=f"fine has no setting '{name}'"):
        build_settings(CLASSES, [(f"fine.{name}", "0")])


@pytest.mark.parametrize(("strategy", "growth"), [("joint", TOLD), ("two-stage", GrowthSettings())])
def test_what_coarse_was_told_of_growth_travels_with_the_joint_strategy(strategy, growth, tmp_path):
    tmp_path.joinpath("coarse").mkdir()
    out = ArtifactWriter(tmp_path / "coarse")
    depth = {3: np.ones((2, 2), np.float32)}
    StoredCoarse(strategy, 90, depth, TOLD).write(out, b"png")
    out.finish({})
    found = StoredCoarse.read(Artifact(tmp_path / "coarse"))
    assert (found.strategy, found.iterations, found.growth) == (strategy, 90, growth)
    np.testing.assert_array_equal(found.depth[3], depth[3])
    assert ("growth" in Artifact(tmp_path / "coarse").attrs) is (strategy == "joint")


def test_the_trainer_of_fine_gets_both():
    got = training_settings(FineSettings(iterations=7, seed=5, spread=0.5, lr_scale=0.2), TOLD)
    assert got == TrainingSettings(iterations=7, seed=5, spread=0.5, budget=700, open_until=0.2, hidden=0.0)
