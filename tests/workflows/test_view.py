"""`e4dgs view`: the pictures that it shows, the model that it finds, and the page in a real browser."""

import shutil
import subprocess
import sys
import time
from io import BytesIO

import numpy as np
import pytest
import torch
from e4dgs.rasterizer import Camera
from e4dgs.workflows.cli import main
from PIL import Image

QUICK = ["--set", "coarse.iterations=300", "--set", "hulls.budget=60", "--set", "fine.iterations=20", "--device", "cpu"]


@pytest.fixture(scope="module")
def finished(dnerf_capture, tmp_path_factory):
    workspace = tmp_path_factory.mktemp("view") / "workspace"
    assert main(["run", "all", str(dnerf_capture.root), "--workspace", str(workspace), *QUICK]) == 0
    return dnerf_capture, workspace


@pytest.fixture(scope="module")
def scene(finished):
    """The model of the finished run, and the camera of its first view."""
    import e4dgs

    capture, workspace = finished
    model, truth = e4dgs.load(capture.root, workspace=workspace), capture.views[0].camera
    pose = torch.tensor(truth.cam_from_world).float()
    return model, Camera(torch.tensor(truth.K).float(), pose, truth.width, truth.height, model.near)


def test_all_primitives_in_colour_are_the_model_s_own_render(scene):
    from e4dgs.workflows.view.looks import picture

    model, camera = scene
    own = model.render(camera, 0.3).color.clamp(0, 1).numpy() * 255
    assert np.abs(picture(model, camera, 0.3) - own).max() <= 0.5 + 1e-3


def test_each_kind_and_what_moves_can_be_seen_alone(scene):
    from e4dgs.workflows.view.looks import chosen

    model, camera = scene
    assert len(model.convexes) and bool(model.gaussians.dynamic.any())
    count = {name: tuple(len(kind.opacities) for kind in chosen(model, camera, 0.5, name)) for name in ("all", "Gaussians", "convexes")}
    assert count["Gaussians"] == (len(model.gaussians), 0) and count["convexes"] == (0, len(model.convexes))
    parts = [[len(kind.opacities) for kind in chosen(model, camera, 0.5, name)] for name in ("dynamic", "static")]
    assert tuple(np.sum(parts, 0)) == count["all"] and parts[0][0] == int(model.gaussians.dynamic.sum())


def test_depth_flow_edges_and_outlines_differ_from_colour(scene):
    from e4dgs.workflows.view.looks import picture

    model, camera = scene
    shown = {look: picture(model, camera, 1.0, look) for look in ("colour", "depth", "flow", "edges")}
    shown["outlines"] = picture(model, camera, 1.0, outlines=True)
    for name, image in shown.items():
        assert image.shape == (camera.height, camera.width, 3) and image.dtype == np.uint8
        assert image.std() > 1, f"{name} is empty"
        assert name == "colour" or np.abs(image.astype(int) - shown["colour"]).mean() > 0.1, name


def test_a_photo_lies_where_the_render_of_its_camera_lies(scene):
    """The window has another size and lens than the photo."""
    from e4dgs.workflows.view.looks import photo_beside, picture

    model, camera = scene
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


def test_a_run_that_trains_is_seen_by_its_checkpoints(finished):
    """The same words find the run's checkpoint as long as its result is not there."""
    from e4dgs.scene.training.checkpoint import model_of
    from e4dgs.workflows.session import Options, open_session
    from e4dgs.workflows.view.source import Source

    capture, workspace = finished
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
        run.wait(timeout=30)
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


CHROMIUM = shutil.which("chromium")
FLAGS = [
    "--no-sandbox --disable-quic --no-first-run --disable-background-networking --disable-component-update --disable-sync",
    "--use-gl=angle --use-angle=swiftshader --enable-unsafe-swiftshader",
]


@pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium: apt-get install chromium")
def test_the_page_shows_our_render_and_follows_its_controls(finished, scene):
    import e4dgs
    from playwright.sync_api import sync_playwright

    capture, workspace = finished
    model, _ = scene
    command = [sys.executable, "-m", "e4dgs.workflows.cli", "view", str(capture.root), "--workspace", str(workspace), "--no-browser"]
    server = subprocess.Popen([*command, *QUICK, "--port", "8471"], stdout=subprocess.PIPE, text=True)
    try:
        assert server.stdout is not None
        address = next(word for word in server.stdout.readline().split() if word.startswith("http"))
        with sync_playwright() as chromium:
            browser = chromium.chromium.launch(executable_path=CHROMIUM, args=" ".join(FLAGS).split())
            page = browser.new_page(viewport={"width": 900, "height": 500})
            outside: list[str] = []
            page.on("request", lambda request: outside.append(request.url) if address.split("//")[1] not in request.url else None)
            page.goto(address)
            numbers = page.locator("input[inputmode=decimal], input[inputmode=numeric]")  # time, speed, side, frame, photo
            numbers.nth(4).wait_for(timeout=60_000)

            def turn(k: int, value: float) -> np.ndarray:
                numbers.nth(k).fill(str(value))
                numbers.nth(k).press("Enter")
                return settled(page)

            i = 3
            shown = turn(3, i)
            truth, t = capture.views[i].camera, capture.views[i].time
            focal = 500 / truth.height * truth.K[1, 1]
            lens = torch.tensor([[focal, 0, 450], [0, focal, 250], [0, 0, 1]], dtype=torch.float32)
            camera = e4dgs.Camera(lens, torch.tensor(truth.cam_from_world).float(), 900, 500, model.near)
            own = (model.render(camera, float(t)).color.clamp(0, 1) * 255).numpy()
            free = np.s_[170:, :500]  # beside the panel, below a warning about software rendering
            assert psnr(shown[free], own[free]) >= 30
            later = turn(0, 1.0 if t < 0.5 else 0.0)
            assert np.abs(later[free].astype(float) - shown[free]).max() > 30, "another time, another picture"
            assert not [url for url in outside if not url.startswith(("data:", "blob:"))], "nothing is asked of others"
            browser.close()
    finally:
        server.terminate()
        server.wait(timeout=30)


def settled(page) -> np.ndarray:
    """The picture once it does not change any more."""
    before = None
    for _ in range(40):
        time.sleep(0.5)
        now = np.asarray(Image.open(BytesIO(page.screenshot())).convert("RGB"))
        if before is not None and np.array_equal(now, before):
            return now
        before = now
    raise AssertionError("the picture never came to rest")
