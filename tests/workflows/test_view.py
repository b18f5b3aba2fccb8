"""`e4dgs view`: the pictures that it shows and the model that it finds."""

import subprocess
import sys
import time

import numpy as np
import pytest
import torch
from e4dgs.rasterizer import Camera
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
    assert shown["static"].min() == 255
    assert shown["dynamic"].min() < 200 and not np.array_equal(shown["dynamic"], shown["all"])


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
    assert main(["view", str(dnerf_capture.root), "--workspace", str(tmp_path / "none"), "--no-browser"]) == 1
    assert "e4dgs run all" in capsys.readouterr().err


def test_a_run_that_trains_is_seen_by_its_checkpoints(finished_run):
    """The same words find the run's checkpoint as long as its result is not there."""
    from e4dgs.scene.training.checkpoint import model_of
    from e4dgs.workflows.session import Options, open_session
    from e4dgs.workflows.view.source import Source

    capture, workspace = finished_run
    longer = ["coarse.iterations=100000", "coarse.checkpoint_seconds=0.5", "coarse.patience=100000"]
    source = Source(open_session(Options(capture.root, workspace, assignments=longer, device="cpu")))
    command = [sys.executable, "-m", "e4dgs.workflows.cli", "run", "coarse", str(capture.root), "--workspace", str(workspace)]
    run = subprocess.Popen([*command, "--device", "cpu", *(word for one in longer for word in ("--set", one))], stdout=subprocess.DEVNULL)
    try:
        first = wait_for(source.newest)
        assert first.title.startswith("coarse, step ") and not source.final
        assert len(first.model.gaussians) and first.model.field is not None and first.model.near > 0
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
