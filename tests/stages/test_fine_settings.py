"""`fine` grows only with the joint strategy, and then as `coarse` was told: it offers none of its own. And how long it refines."""

from pathlib import Path

import numpy as np
import pytest
from e4dgs.pipeline import Artifact, ArtifactWriter, SettingsError, build_settings
from e4dgs.scene.motion.nodes.control_nodes import ControlNodes
from e4dgs.scene.settings import GrowthSettings, TrainingSettings
from e4dgs.stages.coarse.artifact import StoredCoarse
from e4dgs.stages.coarse.settings import CoarseSettings
from e4dgs.stages.facts import Facts
from e4dgs.stages.fine.defaults import auto_lr_scale, fine_iterations
from e4dgs.stages.fine.run import training_settings
from e4dgs.stages.fine.settings import FineSettings
from e4dgs.stages.fine.stage import Fine
from e4dgs.stages.seeds.settings import SeedsSettings
from e4dgs.stages.shared.model import read_model, write_model
from run_stage import run_frames, run_stage
from sliding_gaussians import fresh, wandering_views

SAMPLE = Path(__file__).parents[2] / "samples" / "cube_and_ball"
CLASSES = {"seeds": SeedsSettings, "coarse": CoarseSettings, "fine": FineSettings}
TOLD = GrowthSettings(budget=700, open_until=0.2, hidden=0.0)


@pytest.mark.parametrize("name", sorted(set(GrowthSettings.model_fields) - {"budget"}))
def test_growth_is_set_for_coarse_alone(name):
    assert getattr(build_settings(CLASSES, [(f"coarse.{name}", "0")])["coarse"], name) == 0
    with pytest.raises(SettingsError, match=f"fine has no setting '{name}'"):
        build_settings(CLASSES, [(f"fine.{name}", "0")])


@pytest.mark.parametrize(("name", "value"), [("budget", 700), ("seed", 5), ("motion", "lifetimes")])
def test_seeds_are_placed_for_what_coarse_trains(name, value):
    """However it is written: as the group's, or as it was before `seeds` was a stage."""
    for given in (f"train.{name}", f"coarse.{name}"):
        built = build_settings(CLASSES, [(given, str(value))])
        assert getattr(built["seeds"], name) == getattr(built["coarse"], name) == value


def test_the_older_name_of_the_number_of_seeds_is_understood():
    lines: list[str] = []
    assert build_settings(CLASSES, [("coarse.seeds", "300")], lines.append)["seeds"].count == 300
    assert build_settings(CLASSES, [("coarse.seeds", "0")], lines.append)["seeds"].count is None
    assert lines[0] == "coarse.seeds is now seeds.count"


@pytest.mark.parametrize(("strategy", "growth"), [("joint", TOLD), ("two-stage", GrowthSettings())])
def test_what_coarse_was_told_of_growth_travels_with_the_joint_strategy(strategy, growth, tmp_path):
    tmp_path.joinpath("coarse").mkdir()
    out = ArtifactWriter(tmp_path / "coarse")
    StoredCoarse(strategy, 90, TOLD).write(out)
    out.finish({})
    found = StoredCoarse.read(Artifact(tmp_path / "coarse"))
    assert (found.strategy, found.iterations, found.growth) == (strategy, 90, growth)
    assert ("growth" in Artifact(tmp_path / "coarse").attrs) is (strategy == "joint")


def test_the_trainer_of_fine_gets_both():
    got = training_settings(FineSettings(iterations=7, seed=5, spread_weight=0.5, lr_scale=0.2), TOLD)
    assert got == TrainingSettings(iterations=7, seed=5, spread_weight=0.5, budget=700, open_until=0.2, hidden=0.0)


def test_steps_of_fine():
    assert fine_iterations(FineSettings()) == 1500 and fine_iterations(FineSettings(effort=0.2)) == 300
    assert fine_iterations(FineSettings(iterations=7, effort=0.2)) == 7


@pytest.mark.parametrize(("cameras", "static", "rate"), [(1, False, 0.1), (1, True, 0.3), (8, False, 0.3)])
def test_fine_begins_gently_where_each_time_is_seen_once(cameras, static, rate):
    facts = Facts(
        frames=120, times=15 if cameras > 1 else 120, cameras=cameras, pairs=0 if static else 104, static=static, width=480, height=270
    )
    assert auto_lr_scale(FineSettings(), facts) == rate
    assert auto_lr_scale(FineSettings(lr_scale=0.5), facts) == 0.5


def test_large_clips_get_fewer_steps_of_fine_on_a_cpu():
    clip = Facts(frames=120, times=120, cameras=1, pairs=104, width=800, height=500)
    assert fine_iterations(FineSettings(), clip) == 750 and fine_iterations(FineSettings(), clip, "cuda") == 1500
    assert fine_iterations(FineSettings(effort=0.2), clip) == 300, "as for smaller pictures with --preset fast"
    assert fine_iterations(FineSettings(effort=0.1), clip) == 150


def test_with_nodes_and_without_convexes_the_model_of_coarse_is_kept_unless_steps_are_asked_for(tmp_path):
    frames = run_frames(SAMPLE, tmp_path)
    inputs = {"frames": frames.artifact, "poses": None, "flow": None, "seeds": None, "hulls": None}
    capture = frames.context.capture
    model = fresh(wandering_views(12), static=True)
    model.motion = ControlNodes.over(model.gaussians.means.detach().numpy())
    tmp_path.joinpath("coarse").mkdir()
    out = ArtifactWriter(tmp_path / "coarse")
    StoredCoarse("two-stage", 90, GrowthSettings()).write(out)
    write_model(out, model)
    out.finish({})
    before, inputs = model.to_arrays(), inputs | {"coarse": Artifact(tmp_path / "coarse")}
    for settings, kept in ((FineSettings(), True), (FineSettings(iterations=3), False)):
        fine = run_stage(Fine(), capture, tmp_path / str(kept), settings, inputs)
        after = read_model(fine.artifact).to_arrays()
        assert all(np.array_equal(before[name], after[name]) for name in before) is kept
        assert any("the model of `coarse` is kept" in line for line in fine.lines) is kept


def test_the_plan_knows_when_nothing_is_left_to_refine():
    nodes = {"width": 400, "height": 400, "frames": 100, "cameras": 100, "times": 100, "pairs": 0, "static": False}
    rig = nodes | {"cameras": 10, "times": 10, "pairs": 90}
    fine = Fine()
    assert "refined already" in fine.applies(nodes, FineSettings()).reason and fine.estimate(nodes, FineSettings()) < 5
    for facts, settings in ((rig, FineSettings()), (nodes, FineSettings(iterations=1500))):
        assert (
            fine.applies(facts, settings).reason == "Gaussians, and convexes where hulls places some"
            and fine.estimate(facts, settings) > 20
        )
