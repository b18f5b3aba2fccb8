"""The page of `e4dgs view` in a real Chromium: our render, every control, and a model that goes on being trained."""

import re
import signal
import subprocess
import sys
import time
from contextlib import contextmanager
from io import BytesIO
from types import SimpleNamespace

import numpy as np
import pytest
import tiny_run
import torch
from PIL import Image

COMMAND = [sys.executable, "-m", "e4dgs.workflows.cli"]
WIDTH, HEIGHT = 900, 500
FREE = np.s_[170:, :500]  # beside the panel, below a warning about software rendering
TIME, SPEED, SIDE, FRAME, PHOTO = range(5)  # the order of the panel's numbers


@contextmanager
def running(words, **more):
    """A process that is ended as by Ctrl-C, which a shell's background jobs do not hear; on a busy machine that takes its time."""
    process = subprocess.Popen([*COMMAND, *words], text=True, **more)
    try:
        yield process
    finally:
        process.send_signal(signal.SIGTERM)
        try:
            process.wait(timeout=90)
        except subprocess.TimeoutExpired:
            process.kill()
            raise


@pytest.fixture(scope="module")
def address(finished_run):
    capture, workspace = finished_run
    words = ["view", str(capture.root), "--workspace", str(workspace), "--no-browser", *tiny_run.QUICK, "--port", "8471"]
    with running(words, stdout=subprocess.PIPE) as server:
        yield next(word for word in server.stdout.readline().split() if word.startswith("http"))


class Panel:
    """A page of the viewer, and its controls by their names."""

    def __init__(self, browser, address: str) -> None:
        self.page = browser.new_page(viewport={"width": WIDTH, "height": HEIGHT})
        self.outside: list[str] = []
        self.page.on("request", lambda asked: self.outside.append(asked.url) if address.split("//")[1] not in asked.url else None)
        self.page.goto(address)
        self.numbers = self.page.locator("input[inputmode=decimal], input[inputmode=numeric]")
        self.numbers.nth(PHOTO).wait_for(timeout=60_000)

    def turn(self, k: int, value: float) -> np.ndarray:
        self.numbers.nth(k).fill(str(value))
        self.numbers.nth(k).press("Enter")
        return self.settled()

    def choose(self, now: str, wanted: str) -> np.ndarray:
        """In the list that shows ``now``."""
        self.page.locator(f"input[value='{now}']").first.click()
        self.page.get_by_role("option", name=wanted, exact=True).click()
        return self.settled()

    def drag(self, across: int) -> None:
        """With the mouse, to the side, over ``across`` px."""
        self.page.mouse.move(150, 400)
        self.page.mouse.down()
        for k in range(1, 11):
            self.page.mouse.move(150 + across * k / 10, 400)
        self.page.mouse.up()

    def press(self, name: str) -> None:
        self.page.get_by_label(name).first.click()

    def picture(self) -> np.ndarray:
        return np.asarray(Image.open(BytesIO(self.page.screenshot())).convert("RGB"))[FREE].astype(float)

    def settled(self) -> np.ndarray:
        """The picture once it does not change any more."""
        before = None
        for _ in range(60):
            time.sleep(0.4)
            now = self.picture()
            if before is not None and np.array_equal(now, before):
                return now
            before = now
        raise AssertionError("the picture never came to rest")

    def says(self, pattern: str, seconds: float = 120.0) -> str:
        """What the panel says once it says ``pattern``."""
        self.page.wait_for_function("pattern => new RegExp(pattern).test(document.body.innerText)", arg=pattern, timeout=1000 * seconds)
        found = re.search(pattern, self.page.inner_text("body"))
        assert found is not None
        return found[0]


@pytest.fixture
def panel(browser, address):
    panel = Panel(browser, address)
    yield panel
    panel.page.close()
    assert not [url for url in panel.outside if not url.startswith(("data:", "blob:"))], "nothing is asked of others"


def psnr(a: np.ndarray, b: np.ndarray) -> float:
    return float(-10 * np.log10(np.square((a - b) / 255).mean()))


def test_the_page_shows_our_render_and_follows_frame_and_time(finished_run, finished_scene, panel):
    from e4dgs.rasterizer import Camera

    capture, model, i = finished_run[0], finished_scene[0], 3
    shown = panel.turn(FRAME, i)
    truth, t = capture.views[i].camera, capture.views[i].time
    focal = HEIGHT / truth.height * truth.K[1, 1]
    lens = torch.tensor([[focal, 0, WIDTH / 2], [0, focal, HEIGHT / 2], [0, 0, 1]], dtype=torch.float32)
    camera = Camera(lens, torch.tensor(truth.cam_from_world).float(), WIDTH, HEIGHT, model.near)
    own = (model.render(camera, float(t)).color.clamp(0, 1) * 255).numpy()
    assert psnr(shown, own[FREE]) >= 30
    later = panel.turn(TIME, 1.0 if t < 0.5 else 0.0)
    assert np.abs(later - shown).max() > 30, "another time, another picture"


def test_a_drag_to_the_side_goes_around_the_scene_upright(finished_run, finished_scene, panel):
    """Half the window's height is half a turn: the camera then stands opposite, as high as before, and the scene is not rolled."""
    from e4dgs.rasterizer import Camera
    from e4dgs.scene.camera_paths import centres, look_at
    from e4dgs.stages.exports.camera_path import looked_at

    capture, model, i = finished_run[0], finished_scene[0], 3
    panel.turn(FRAME, i)
    train = [view for view in capture.views if view.split == "train"]
    poses = np.stack([view.camera.cam_from_world for view in train])
    K = np.stack([view.camera.K for view in train])
    first = train[0].camera
    times = np.array([view.time for view in train])
    frames = SimpleNamespace(cam_from_world=poses, K=K, train=np.arange(len(train)), time=times, width=first.width, height=first.height)
    truth = capture.views[i]
    pose, up = truth.camera.cam_from_world, np.array([0.0, 0, 1])
    start = train[0].camera.cam_from_world
    distance = np.linalg.norm(looked_at(frames, model) - centres(start[None])[0])
    eye = centres(pose[None])[0]
    target = eye + distance * pose[2, :3]
    offset = eye - target
    opposite = look_at(target + np.array([-offset[0], -offset[1], offset[2]]), target, up)
    panel.drag(HEIGHT // 2)
    shown = panel.settled()
    focal = HEIGHT / truth.camera.height * truth.camera.K[1, 1]
    lens = torch.tensor([[focal, 0, WIDTH / 2], [0, focal, HEIGHT / 2], [0, 0, 1]], dtype=torch.float32)
    camera = Camera(lens, torch.tensor(opposite).float(), WIDTH, HEIGHT, model.near)
    own = (model.render(camera, float(truth.time)).color.clamp(0, 1) * 255).numpy()
    assert psnr(shown, own[FREE]) >= 28


def test_the_toggles_the_photo_and_play_change_the_picture(panel):
    plain = panel.turn(FRAME, 3)
    photo = panel.turn(PHOTO, 1.0)
    assert 10 < psnr(photo, plain) < 35, "the photo is like the render, and sharper"
    assert np.abs(panel.turn(PHOTO, 0.0) - plain).mean() < 1
    panel.press("Outlines of convexes")
    assert np.abs(panel.settled() - plain).max() > 30
    panel.press("Outlines of convexes")
    convexes = panel.choose("all", "convexes")
    assert np.abs(convexes - plain).max() > 30
    depth = panel.choose("colour", "depth")
    assert np.abs(depth - convexes).max() > 30
    flow = panel.choose("depth", "flow")
    assert np.abs(flow - depth).max() > 30 and np.abs(panel.choose("convexes", "all") - flow).max() > 30
    panel.press("Play")
    before = float(panel.numbers.nth(TIME).input_value())
    panel.page.wait_for_function("([box, before]) => box.value != before", arg=[panel.numbers.nth(TIME).element_handle(), before])
    panel.press("Play")
    panel.settled()


def test_a_viewer_beside_a_run_waits_for_it_and_goes_on_with_its_training(browser, finished_run, tmp_path):
    """`run --view`: it opens the page by itself once there is a checkpoint, swaps newer ones in, and ends with the run's Ctrl-C."""
    capture, _ = finished_run
    opened = tmp_path / "opened"
    script = tmp_path / "browser"
    script.write_text(f'#!/bin/sh\necho "$1" > "{opened}.part" && mv "{opened}.part" "{opened}"\n')
    script.chmod(0o755)
    longer = ["coarse.iterations=100000", "coarse.checkpoint_seconds=0.5", "coarse.patience=100000"]
    words = ["run", "coarse", str(capture.root), "--workspace", str(tmp_path / "workspace"), "--device", "cpu", "--view"]
    words += [word for one in longer for word in ("--set", one)]
    with running(words, stdout=subprocess.DEVNULL, env=tiny_run.environment(BROWSER=str(script))):
        until = time.monotonic() + 120
        while not opened.exists():
            assert time.monotonic() < until, "no page was opened"
            time.sleep(0.2)
        address = opened.read_text().strip()
        panel = Panel(browser, address)
        first = panel.says(r"coarse, step [\d,]+")
        panel.says(rf"coarse, step (?!{first.split()[-1]}\b)[\d,]+")
        panel.page.close()
    until = time.monotonic() + 20
    while answers(address):
        assert time.monotonic() < until, "the viewer outlives the run that started it"
        time.sleep(0.2)


def answers(address: str) -> bool:
    import socket

    with socket.socket() as asking:
        return asking.connect_ex(("127.0.0.1", int(address.rsplit(":", 1)[1]))) == 0
