"""`e4dgs view`: the pictures that it shows and the model that it finds."""

import subprocess
import sys
import time
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from e4dgs.rasterizer import Camera
from e4dgs.scene.motion.static import Static
from e4dgs.workflows.cli import main


def test_all_primitives_in_colour_are_the_model_s_own_render(finished_scene):
    from e4dgs.workflows.view.looks import picture

    model, camera = finished_scene
    own = model.render(camera, 0.3).color.clamp(0, 1).numpy() * 255
    assert np.abs(picture(model, camera, 0.3) - own).max() <= 0.5 + 1e-3


def test_each_kind_and_what_moves_can_be_seen_alone(finished_scene):
    from e4dgs.workflows.view.looks import chosen

    model, camera = finished_scene
    assert len(model.convexes) and bool(model.gaussians.dynamic.any())
    count = {name: tuple(len(kind.opacities) for kind in chosen(model, camera, 0.5, name)) for name in ("all", "Gaussians", "convexes")}
    assert count["Gaussians"] == (len(model.gaussians), 0) and count["convexes"] == (0, len(model.convexes))
    parts = [[len(kind.opacities) for kind in chosen(model, camera, 0.5, name)] for name in ("dynamic", "static")]
    assert tuple(np.sum(parts, 0)) == count["all"] and parts[0][0] == int(model.gaussians.dynamic.sum())


def test_depth_flow_edges_and_outlines_differ_from_colour(finished_scene):
    from e4dgs.workflows.view.looks import picture

    model, camera = finished_scene
    shown = {look: picture(model, camera, 1.0, look) for look in ("colour", "depth", "flow", "edges")}
    shown["outlines"] = picture(model, camera, 1.0, outlines=True)
    for name, image in shown.items():
        assert image.shape == (camera.height, camera.width, 3) and image.dtype == np.uint8
        assert image.std() > 1, f"{name} is empty"
        assert name == "colour" or np.abs(image.astype(int) - shown["colour"]).mean() > 0.1, name


def test_flow_is_that_of_the_primitives_that_are_chosen(finished_scene):
    """What stands still alone shows no flow at all: white. What moves alone shows the flow that is there."""
    from e4dgs.workflows.view.looks import picture

    model, camera = finished_scene
    shown = {name: picture(model, camera, 0.5, "flow", name) for name in ("all", "dynamic", "static")}
    assert shown["static"][: round(0.8 * camera.height)].min() == 255, "below, it is said that nothing moves"
    assert shown["dynamic"].min() < 200 and not np.array_equal(shown["dynamic"], shown["all"])


def test_a_layer_with_nothing_in_it_says_so(finished_scene):
    """Convexes alone of a model without convexes were a white page."""
    from e4dgs.scene.model import Model
    from e4dgs.scene.primitives import ConvexSet
    from e4dgs.workflows.view.looks import absent, picture

    model, camera = finished_scene
    for look in ("colour", "depth", "edges"):
        assert absent(model, look, "all", True) is None and absent(model, look, "convexes", False) is None
    without = Model(model.gaussians, ConvexSet.empty(6, 0), model.motion, model.sh_degree, model.near, model.background)
    assert absent(without, "colour", "convexes", False) == "this model has no convexes"
    assert absent(without, "colour", "all", True) == "this model has no convexes to outline"
    assert absent(without, "colour", "all", False) is None
    still = Model(model.gaussians, model.convexes, Static(), model.sh_degree, model.near, model.background)
    assert absent(still, "flow", "all", False) == absent(model, "flow", "static", False) == "no flow: nothing of what is shown moves"
    shown = picture(without, camera, 0.5, primitives="convexes")
    assert np.ptp(shown) > 150, "there is something to read"


def test_a_photo_lies_where_the_render_of_its_camera_lies(finished_scene):
    """The window has another size and lens than the photo."""
    from e4dgs.workflows.view.looks import photo_beside, picture

    model, camera = finished_scene
    lens = camera.K.clone()
    lens[:2] *= 2
    lens[0, 2] += 13
    window = Camera(lens, camera.cam_from_world, 2 * camera.width + 30, 2 * camera.height, model.near)
    render, photo = picture(model, window, 0.5), picture(model, camera, 0.5)
    shown = photo_beside(np.zeros_like(render), photo, camera.K.numpy(), window, 0.5)
    middle = round(0.5 * window.width)
    assert not shown[:, middle + 1 :].any(), "right of the line is the render, here black"
    covered = np.s_[8:-8, 24 : middle - 8]
    assert psnr(shown[covered], render[covered]) > 28
    shifted = np.roll(shown, 3, axis=1)
    assert psnr(shifted[covered], render[covered]) < psnr(shown[covered], render[covered]) - 3, "the comparison tells a shift"


@pytest.mark.parametrize(("fixed", "full"), [(0.005, 0.02), (0.01, 0.3), (0.03, 0.8), (0.0, 3.0)])
def test_the_size_while_moving_gives_fifteen_pictures_a_second(fixed, full):
    """Whatever a picture of full size takes, in seconds, of which ``fixed`` do not depend on its size."""
    from e4dgs.workflows.view.server import FIRST_SCALE, SMALLEST, next_scale

    def settled(scale: float, pictures: int) -> float:
        for _ in range(pictures):
            scale = next_scale(scale, fixed + full * scale * scale)
        return scale

    scale = settled(FIRST_SCALE, 12)
    took = fixed + full * scale * scale
    assert scale == SMALLEST or (1 / took >= 15 and (scale == 1 or 1 / took <= 30)), (scale, took)
    slow = next_scale(scale, 2.0)
    assert slow >= 0.7 * scale - 1e-9 or slow == SMALLEST
    assert settled(slow, 6) == pytest.approx(scale, rel=0.1)


def psnr(a: np.ndarray, b: np.ndarray) -> float:
    return float(-10 * np.log10(np.square((a.astype(float) - b) / 255).mean()))


def test_without_a_model_it_says_how_to_make_one(dnerf_capture, tmp_path, capsys):
    assert main(["view", str(dnerf_capture.root), "--workspace", str(tmp_path / "none"), "--no-browser"]) == 2
    assert "e4dgs run all" in capsys.readouterr().err


def test_a_run_that_trains_is_seen_by_its_checkpoints(finished_run):
    """The same words find the run's checkpoint as long as its result is not there."""
    from e4dgs.scene.training.checkpoint import model_of
    from e4dgs.workflows.session import Choice, Options, open_session
    from e4dgs.workflows.view.source import Source

    capture, workspace = finished_run
    longer = ["coarse.iterations=100000", "coarse.checkpoint_seconds=0.5", "coarse.patience=100000"]
    source = Source(open_session(Options(capture.root, workspace, Choice(set=longer, device="cpu"))))
    command = [sys.executable, "-m", "e4dgs.workflows.cli", "run", "coarse", str(capture.root), "--workspace", str(workspace)]
    run = subprocess.Popen([*command, "--device", "cpu", *(word for one in longer for word in ("--set", one))], stdout=subprocess.DEVNULL)
    try:
        first = wait_for(source.newest)
        assert first.title.startswith("coarse, step ") and not source.final
        assert len(first.model.gaussians) and first.model.motion is not None and first.model.near > 0
        assert wait_for(source.newest).title != first.title, "it goes on with the training"
    finally:
        run.terminate()
        run.wait(timeout=90)  # a SIGTERM that is lost comes again after ten seconds
    folder = next((workspace / "store" / "checkpoints").glob("coarse-*"))
    model, step = model_of(folder)
    assert step > 0 and f"{step:,}" not in first.title
    camera = Camera(torch.eye(3) * 50, torch.eye(4), 16, 16)
    assert bool(torch.isfinite(model.render(camera, 0.5).color).all())


def wait_for(ask, seconds: float = 60.0):
    until = time.monotonic() + seconds
    while (found := ask()) is None:
        assert time.monotonic() < until, "nothing came"
        time.sleep(0.2)
    return found


def rolled(degrees: float) -> np.ndarray:
    """A camera at (0, -5, 3) that looks at the origin of a world whose z points upwards, turned about its axis."""
    from e4dgs.scene.camera_paths import look_at

    pose = look_at(np.array([0.0, -5, 3]), np.zeros(3), np.array([0.0, 0, 1]))
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    turn = np.eye(4)
    turn[:2, :2] = [[c, -s], [s, c]]
    return turn @ pose


def test_a_camera_keeps_its_roll_until_the_first_drag_then_stands_upright():
    """About its own up direction, a drag to the side would roll the scene and end under its floor."""
    import viser.transforms as tf
    from e4dgs.workflows.view.server import View, Viewer, _Browser

    viewer = object.__new__(Viewer)
    viewer.frames = SimpleNamespace(cam_from_world=np.stack([rolled(0), rolled(30)]), time=np.zeros(2))
    viewer.up, viewer.distance = np.array([0.0, 0, 1]), 5.0
    assert [viewer.leans(i) for i in range(2)] == [False, True]
    browser = object.__new__(_Browser)
    browser.viewer, browser.leaning, browser.sent = viewer, 1, time.monotonic() - 1
    browser.client = SimpleNamespace(camera=SimpleNamespace(up_direction=None))

    def view(pose: np.ndarray, t: float) -> View:
        eye = -pose[:3, :3].T @ pose[:3, 3]
        return View(tuple(tf.SO3.from_matrix(pose[:3, :3].T).wxyz), tuple(eye), 1.0, 10, 10, SimpleNamespace(time=t), 0)

    browser._straighten(view(rolled(30), 0.7))
    assert browser.client.camera.up_direction is None, "another time is no drag"
    browser._straighten(view(rolled(31), 0.0))
    assert browser.client.camera.up_direction is viewer.up and browser.leaning is None
