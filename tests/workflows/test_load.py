"""`e4dgs.load`: a script gets the model by the scene's folder or by the capture, and is told what to do where there is none."""

import re
import shlex
import shutil

import e4dgs
import numpy as np
import pytest
import torch
from e4dgs.pipeline import ArtifactError
from e4dgs.workflows.cli import main

QUICK = ["--set", "coarse.iterations=20", "--set", "hulls.budget=0", "--set", "fine.iterations=0", "--device", "cpu"]


@pytest.fixture(scope="module")
def finished(dnerf_capture, tmp_path_factory):
    workspace = tmp_path_factory.mktemp("load") / "workspace"
    assert main(["run", "all", str(dnerf_capture.root), "--workspace", str(workspace), *QUICK]) == 0
    return dnerf_capture, workspace


def test_a_scenes_folder_and_its_capture_give_the_same_model(finished):
    capture, workspace = finished
    (scene,) = (workspace / "scenes").iterdir()
    by_folder, by_capture = e4dgs.load(scene), e4dgs.load(capture.root, workspace=workspace)
    for name, array in by_folder.to_arrays().items():
        assert np.array_equal(array, by_capture.to_arrays()[name])


def test_a_render_takes_a_background(finished):
    capture, workspace = finished
    model = e4dgs.load(capture.root, workspace=workspace)
    truth = capture.views[0].camera
    camera = e4dgs.Camera(torch.tensor(truth.K).float(), torch.tensor(truth.cam_from_world).float(), truth.width, truth.height)
    black, white = (model.render(camera, 0.5, torch.full((3,), value)) for value in (0.0, 1.0))
    assert torch.allclose(white.color - black.color, (1 - black.alpha)[..., None].expand_as(black.color), atol=1e-5)


def test_what_was_never_run_is_said_with_the_command_that_runs_it(finished, tmp_path):
    capture, workspace = finished
    with pytest.raises(ArtifactError, match=re.escape(f"e4dgs run all {tmp_path} --workspace {workspace}, or")):
        e4dgs.load(tmp_path, workspace=workspace)
    with pytest.raises(ArtifactError, match="no such file or folder, and no scene of this name in"):
        e4dgs.load("nobody", workspace=workspace)
    (scene,) = (path for path in (workspace / "scenes").iterdir() if path.name not in ("again", "other"))
    bare = tmp_path / "w" / "scenes" / "bare"
    shutil.copytree(scene, bare, ignore=lambda *_: ["records"])
    words = ["e4dgs", "run", "all", str(capture.root), "--workspace", str(tmp_path / "w"), "--device", "cpu", "--name", "bare", *QUICK]
    with pytest.raises(ArtifactError, match="no finished model") as raised:
        e4dgs.load(bare)
    said = shlex.split(str(raised.value).partition("make one with: ")[2])
    assert said[:3] == words[:3] and set(words) <= set(said)


def test_a_stage_that_the_last_run_skipped_gives_no_model(finished):
    capture, workspace = finished
    words = [str(capture.root), "--workspace", str(workspace), "--name", "again"]
    assert main(["run", "all", *words, *QUICK, "--set", "fine.iterations=3"]) == 0
    trained = e4dgs.load(workspace / "scenes" / "again").to_arrays()
    assert main(["run", "all", *words, *QUICK]) == 0
    assert main(["run", "flow", *words, *QUICK]) == 0  # its plan does not mention the skipped stage
    (usual,) = (path for path in (workspace / "scenes").iterdir() if path.name != "again")
    coarse, last = e4dgs.load(usual).to_arrays(), e4dgs.load(workspace / "scenes" / "again").to_arrays()
    assert all(np.array_equal(last[name], array) for name, array in coarse.items())
    assert not all(np.array_equal(last[name], array) for name, array in trained.items())
    shutil.rmtree(workspace / "scenes" / "again")


def test_a_capture_with_two_scenes_is_asked_for_by_folder(finished):
    capture, workspace = finished
    assert main(["run", "all", str(capture.root), "--workspace", str(workspace), "--name", "other", *QUICK]) == 0
    with pytest.raises(ArtifactError, match="several scenes"):
        e4dgs.load(capture.root, workspace=workspace)
    assert len(e4dgs.load(workspace / "scenes" / "other").gaussians)


def test_gaussians_of_a_time_are_tensors_as_exports_have_them(finished, tmp_path):
    """With the types, shapes and units that docs/results.md promises."""
    plyfile = pytest.importorskip("plyfile")
    capture, workspace = finished
    scene = workspace / "scenes" / capture.root.name
    words = [str(scene), "--time", "0.25", "--up", "capture", "--out", str(tmp_path / "a.ply")]
    for classic, option in ((False, ["--antialiased"]), (True, [])):
        gaussians = e4dgs.load_gaussians(scene, classic=classic).at(0.25)
        count = len(gaussians.means)
        shapes = {"means": (3,), "quats": (4,), "scales": (3,), "opacities": (), "sh": (gaussians.sh.shape[1], 3)}
        for name, shape in shapes.items():
            value = getattr(gaussians, name)
            assert (
                value.shape == (count, *shape) and value.dtype == torch.float32 and not value.requires_grad and value.device.type == "cpu"
            )
        assert main(["export", "ply", *words, *option]) == 0
        vertex = plyfile.PlyData.read(str(tmp_path / "a.ply"))["vertex"]
        seen = gaussians.opacities >= 1 / 255
        assert len(vertex) == int(seen.sum()) and np.array_equal(vertex["x"], gaussians.means[seen][:, 0].numpy())
        np.testing.assert_allclose(1 / (1 + np.exp(-vertex["opacity"])), gaussians.opacities[seen], atol=1e-5)
    assert torch.equal(e4dgs.load(scene).at(0.25)[0].means, e4dgs.load_gaussians(scene).at(0.25).means)


@pytest.mark.parametrize("time", [-0.1, 1.5, float("nan"), float("inf")])
def test_a_time_that_no_model_has_is_refused(finished, time):
    capture, workspace = finished
    scene = workspace / "scenes" / capture.root.name
    model = e4dgs.load(scene)
    truth = capture.views[0].camera
    camera = e4dgs.Camera(torch.tensor(truth.K).float(), torch.tensor(truth.cam_from_world).float(), truth.width, truth.height)
    for ask in (lambda: model.at(time), lambda: model.render(camera, time), lambda: e4dgs.load_gaussians(scene).at(time)):
        with pytest.raises(ValueError, match="times from 0"):
            ask()
    model.at(1 + 1e-9), model.at(torch.tensor(0.5)), model.at(np.float32(1.0))
