"""Stage `depth`: skipped where there is nothing to do; else depth of training frames in world units, from files or a network."""

import numpy as np
import pytest
from e4dgs.pipeline import SettingsError, build_settings
from e4dgs.stages.depth import run as work
from e4dgs.stages.depth.artifact import read_depth, read_points
from e4dgs.stages.depth.settings import DepthSettings
from e4dgs.stages.depth.stage import Depth
from e4dgs.stages.frames.settings import FramesSettings, recognise_for
from e4dgs.stages.shared.dataset import load_frameset
from e4dgs.vision.depth.align import INVERSE, METRIC
from e4dgs.workflows.cli import main
from factory import Options, make, render, write_colmap
from PIL import Image
from run_stage import run_frames, run_stage
from tiny_depth_network import save_depth_network

SHOWN = Options(backdrop="room", rig="path", times=16, width=80, height=64, samples=1, fov_degrees=60.0, seed=2)


def truth(written, i):
    view = written.views[i]
    return render(written.synthetic.scene, view.camera, view.time, samples=1).depth


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    """A COLMAP capture without depth."""
    return write_colmap(make(SHOWN), tmp_path_factory.mktemp("plain"), points=3000)


@pytest.fixture(scope="module")
def deep(tmp_path_factory):
    """The same with depth in millimetres beside all images but the last, and confidence: at the top there is nothing to rely on."""
    written = write_colmap(make(SHOWN), tmp_path_factory.mktemp("deep"), points=3000)
    for name in ("depth", "confidence"):
        (written.root / name).mkdir()
    sure = np.full((64, 80), 2, np.uint8)
    sure[:10] = 0
    for i, file in enumerate(written.files[:-1]):
        name = file.removeprefix("images/").rsplit(".", 1)[0] + ".png"
        Image.fromarray(np.rint(1000 * truth(written, i)).astype(np.uint16)).save(written.root / "depth" / name)
        Image.fromarray(sure).save(written.root / "confidence" / name)
    return written


def run_depth(root, folder, **settings):
    frames = run_frames(root, folder)
    return run_stage(Depth(), frames.context.capture, folder, DepthSettings(**settings), {"frames": frames.artifact, "poses": None})


def test_depth_of_files_is_in_world_units(deep, tmp_path):
    ran = run_depth(deep.root, tmp_path)
    found = read_depth(ran.artifact)
    assert found is not None and found.kind == METRIC and found.precise
    assert sorted(found.z) == [1, 2, 3, 4, 5, 6, 7, 9, 10, 11, 12, 13, 14], "training frames with a map"
    for i, z in found.z.items():
        assert np.median(np.abs(z / truth(deep, i) - 1)) < 0.01
        assert (found.confidence[i][:10] == 0).all() and (found.confidence[i][10:] == 1).all()
    assert read_points(ran.artifact) is None, "the capture has points"
    assert any("13 frames, metric" in line and "off the known points" in line for line in ran.lines)


def test_depth_of_a_network_is_aligned_as_inverse_depth(plain, tmp_path, monkeypatch):
    class Knowing:
        """Gives the true inverse depth, up to a scale and a shift of each frame, with an error."""

        def __init__(self, model, device):
            assert (model, device) == ("some/network", "cpu")
            self.kind, self.rng = INVERSE, np.random.default_rng(0)

        def depth(self, picture):
            i = next(i for i in range(16) if np.array_equal(picture, pictures[i]))
            scale, shift, wrong = self.rng.uniform(0.5, 2), self.rng.uniform(0, 0.2), np.exp(0.05 * self.rng.normal(size=(64, 80)))
            return (scale * (wrong / truth(plain, i) + shift)).astype(np.float32)

    frames = load_frameset({"frames": run_frames(plain.root, tmp_path / "first").artifact}, plain.root)
    pictures = [frames.composited(i) for i in range(16)]
    monkeypatch.setattr(work, "DepthNetwork", Knowing)
    found = read_depth(run_depth(plain.root, tmp_path, model="some/network").artifact)
    assert found is not None and found.kind == INVERSE and not found.precise and len(found.z) == 14
    for i, z in found.z.items():
        assert abs(np.median(z / truth(plain, i)) - 1) < 0.02 and np.median(np.abs(z / truth(plain, i) - 1)) < 0.05


def test_a_network_that_knows_nothing_is_not_used(plain, tmp_path):
    ran = run_depth(plain.root, tmp_path, model=save_depth_network(tmp_path / "network"))
    assert read_depth(ran.artifact) is None
    assert any("it is not used, since it has little to do with the known points" in line for line in ran.lines)


def test_without_depth_the_stage_is_skipped_and_nothing_else_changes(plain, deep):
    facts = recognise_for(plain.root, FramesSettings()).facts
    assert "depths" not in facts, "so the results of captures without depth are what they were"
    assert (no := Depth().applies(facts, DepthSettings())).needed is False
    assert no.reason == "the files hold no depth, and none is asked for (depth.model)"
    facts = recognise_for(deep.root, FramesSettings()).facts
    yes = Depth().applies(facts, DepthSettings())
    assert yes.needed and yes.reason == "15 depth maps of the files, aligned to known points"
    asked = Depth().applies(facts, DepthSettings(model="some/network"))
    assert asked.needed and asked.reason == (
        "depth of 14 frames by some/network, in place of the 15 depth maps of the files, aligned to known points"
    )
    inside = Depth().applies({**facts, "alpha": True, "points": False}, DepthSettings())
    assert not inside.needed and inside.reason == "Gaussians begin inside the silhouettes, which need no depth"


def test_the_plan_shows_it_and_a_second_run_reuses_it(plain, deep, tmp_path, capsys):
    assert main(["plan", str(plain.root), "--workspace", str(tmp_path)]) == 0
    row = next(line for line in capsys.readouterr().out.splitlines() if line.startswith("depth"))
    assert row.split()[:2] == ["depth", "skip"] and "the files hold no depth" in row
    command = ["run", "depth", str(deep.root), "--workspace", str(tmp_path)]
    assert main(command) == 0 and "depth: done" in capsys.readouterr().out
    assert main(command) == 0
    again = capsys.readouterr().out
    assert "depth: done" not in again and next(line for line in again.splitlines() if line.startswith("depth")).split()[1] == "cached"


def test_settings_tell_folders_from_names(tmp_path):
    build = lambda text: build_settings({"depth": DepthSettings}, [("depth.model", text)])["depth"].model  # noqa: E731
    assert build(str(tmp_path)) == tmp_path and build("some/network@main") == "some/network@main" and build("none") is None
    with pytest.raises(SettingsError, match=r"there is no such folder, and a name on huggingface\.co looks like OWNER/MODEL"):
        build("/no/such/folder")


def test_the_key_has_the_content_of_the_folder(tmp_path):
    from e4dgs.pipeline.keys import settings_parts

    (tmp_path / "config.json").write_text("{}")
    settings = DepthSettings(model=tmp_path)
    first = settings_parts(settings)
    (tmp_path / ".cache").mkdir()
    assert settings_parts(settings) == first
    (tmp_path / "config.json").write_text("{ }")
    assert settings_parts(settings) != first and set(first["model"]) == {"folder"}
