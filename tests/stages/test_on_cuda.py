"""The stages that learn and render, with `--device cuda`: on `pretending_cuda`, which refuses what a GPU would refuse."""

import numpy as np
from e4dgs.stages.coarse.settings import CoarseSettings
from e4dgs.stages.coarse.stage import Coarse
from e4dgs.stages.evaluate.settings import EvaluateSettings
from e4dgs.stages.evaluate.stage import Evaluate
from e4dgs.stages.fine.settings import FineSettings
from e4dgs.stages.fine.stage import Fine
from e4dgs.stages.flow.settings import FlowSettings
from e4dgs.stages.flow.stage import Flow
from e4dgs.stages.hulls.settings import HullSettings
from e4dgs.stages.hulls.stage import Hulls
from e4dgs.stages.seeds.settings import SeedsSettings
from e4dgs.stages.seeds.stage import Seeds
from factory import Options, make, write_n3v
from pretend_cuda import pretending_cuda
from run_stage import run_frames, run_stage
from simt import needs_compiler


@needs_compiler
def test_a_rig_is_trained_refined_and_evaluated(tmp_path):
    options = Options(backdrop="room", rig="arc", cameras=3, times=3, width=48, height=36, samples=1, fov_degrees=60.0)
    frames = run_frames(write_n3v(make(options), tmp_path / "capture").root, tmp_path / "work")
    capture, made = frames.context.capture, {"frames": frames.artifact}
    few = {"iterations": 12, "sh_degree": 1, "densify_every": 5, "flow_every": 4, "full_from": 0.0}
    stages = [
        (Flow(), FlowSettings(method="dis")),
        (Seeds(), SeedsSettings(count=300)),
        (Coarse(), CoarseSettings(**few)),
        (Hulls(), HullSettings(min_edge_density=0.0, budget=12)),
        (Fine(), FineSettings(iterations=6, sh_degree=1, flow_every=2)),
        (Evaluate(), EvaluateSettings(splits=("test",), max_views=1)),
    ]
    with pretending_cuda():
        for stage, settings in stages:
            inputs = {name: made.get(name) for name in stage.inputs}
            # The threads of `flow` do not see the device that is pretended; tests/vision/test_flow_on_gpu.py has what it does there.
            device = "cpu" if stage.name == "flow" else "cuda"
            made[stage.name] = run_stage(stage, capture, tmp_path / "work", settings, inputs, device=device).artifact
    assert made["fine"].info["training"]["nonfinite_steps"] == 0
    assert made["fine"].array("convexes_points").shape[0] > 0
    assert np.isfinite(made["evaluate"].attrs["metrics"]["splits"]["test"]["psnr"])
