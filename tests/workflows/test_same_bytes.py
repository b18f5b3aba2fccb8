"""The same key gives the same bytes: every stage, run again in another workspace, writes an artifact of the same digest."""

from pathlib import Path

import pytest
import torch
from e4dgs.pipeline import Artifact, Runner
from e4dgs.workflows.session import Choice, Options, open_session
from factory import Options as Scene
from factory import make, write_dnerf, write_n3v

RIG = Scene(backdrop="room", rig="arc", cameras=3, times=4, width=64, height=48, samples=1, fov_degrees=60.0)
QUICK = ["coarse.iterations=60", "seeds.count=200", "hulls.min_edge_density=0.05", "hulls.budget=40", "fine.iterations=30"]


def made(root: Path, workspace: Path, motion: str) -> dict[str, Artifact]:
    """What each stage wrote into a new ``workspace``."""
    options = Options(root, workspace, Choice(set=(*QUICK, f"train.motion={motion}"), device="cpu"))
    outcomes = Runner(open_session(options).job).run()
    assert {outcome.state for outcome in outcomes} <= {"ran", "skipped"}
    return {outcome.stage: outcome.artifact for outcome in outcomes if outcome.artifact is not None}


@pytest.mark.parametrize(("motion", "stages"), [
    ("planes", {"frames", "flow", "seeds", "coarse", "hulls", "fine", "evaluate"}),
    ("nodes", {"frames", "seeds", "coarse", "hulls", "fine", "evaluate"}),
])  # fmt: skip
def test_every_stage_writes_the_same_bytes_again(motion, stages, tmp_path):
    capture = write_n3v(make(RIG), tmp_path) if motion == "planes" else write_dnerf(make(Scene(width=48, height=48, samples=1)), tmp_path)
    first = made(capture.root, tmp_path / "one", motion)
    torch.manual_seed(1)  # nothing comes from the state that a run before has left
    second = made(capture.root, tmp_path / "two", motion)
    assert set(first) == stages and first["coarse"].attrs["model"]["field"]["kind"] == motion
    assert len(first["fine"].read("convexes_dynamic")) > 0
    for stage in stages:
        assert first[stage].path.name == second[stage].path.name, f"{stage}: another key"
        differ = [name for name in sorted({*files(first[stage]), *files(second[stage])})
                  if files(first[stage]).get(name) != files(second[stage]).get(name)]  # fmt: skip
        assert not differ and first[stage].digest == second[stage].digest, f"{stage}: {differ}"


def files(artifact: Artifact) -> dict:
    """Of the manifest, but for what may vary from run to run."""
    return {name: entry for name, entry in artifact.manifest["files"].items() if name != "info.json"}
