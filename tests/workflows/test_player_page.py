"""The web player in a real Chromium draws what the rasterizer draws, of every motion, and survives what happens to pages."""

import base64
import io
from dataclasses import replace

import numpy as np
import pytest
import torch
from e4dgs.rasterizer import rasterize
from e4dgs.scene.formats.web.scene import WebScene
from e4dgs.stages.exports.web_scene import web_scene
from e4dgs.workflows.player.page import page
from made_models import FRAMES, MOTIONS, camera, made
from PIL import Image

ABOUT = {"seconds": 1.0, "up": [0.0, -1.0, 0.0], "target": [0.0, 0.0, 0.0]}
PIXEL = 3.0 / 150
LOST = "const lose = e4dgs.canvas.getContext('webgl2').getExtension('WEBGL_lose_context');"


def about(count=2):
    """Header fields of a capture whose cameras look from ``count`` sides."""
    shots = [(k, camera(1.0 * k)) for k in range(count)]
    cameras = [
        {
            "name": f"photo {k}",
            "time": 0.0,
            "width": shot.width,
            "height": shot.height,
            "cam_from_world": shot.cam_from_world.flatten().tolist(),
            "K": shot.K.flatten().tolist(),
        }
        for k, shot in shots
    ]
    return ABOUT | {"cameras": cameras}


class Page:
    """A page of the player with its own `window.e4dgs`; ``outside`` are the addresses that it asked for."""

    def __init__(self, browser, folder, data: bytes, play=False, poster=None, size=(500, 400)):
        self.file = folder / "scene.html"
        self.file.write_text(page("made", data, poster, (1.0, 0.9, 0.8), play))
        self.page = browser.new_page(viewport={"width": size[0], "height": size[1]})
        self.outside, self.errors = [], []
        self.page.on("request", lambda asked: self.outside.append(asked.url))
        self.page.on("pageerror", lambda error: self.errors.append(str(error)))
        self.page.goto(self.file.as_uri())
        self.page.wait_for_selector("body.ready, body.failed", timeout=60_000)

    def show(self, view, time):
        wanted = {
            "time": time,
            "cam_from_world": view.cam_from_world.flatten().tolist(),
            "K": view.K.flatten().tolist(),
            "width": view.width,
            "height": view.height,
        }
        self.page.evaluate("view => e4dgs.show(view)", wanted)
        return self.picture()

    def picture(self):
        png = self.page.evaluate("e4dgs.canvas.toDataURL('image/png')")
        return np.asarray(Image.open(io.BytesIO(base64.b64decode(png.split(",")[1]))).convert("RGB")) / 255


@pytest.fixture
def opened(browser, tmp_path):
    pages = []

    def open_it(*arguments, **more):
        pages.append(Page(browser, tmp_path, *arguments, **more))
        return pages[-1]

    yield open_it
    for one in pages:
        one.page.close()
        asked = [url for url in one.outside if url != one.file.as_uri() and not url.startswith(("blob:", "data:"))]
        assert not asked, "nothing is asked of others"


def psnr(a, b):
    return float(-10 * np.log10(max(np.square(a - b).mean(), 1e-10)))


@pytest.mark.parametrize("antialiased", [True, False])
@pytest.mark.parametrize("motion", MOTIONS)
def test_the_page_draws_what_the_rasterizer_draws(opened, motion, antialiased):
    """The bars of the file format: 45 dB from numbers as they are, 38 dB from the file as it is written."""
    model = made(motion, degree=3 if motion == "static" else 2, antialiased=antialiased)
    scene, steps = web_scene(model, FRAMES, PIXEL, about())
    found = []
    for data in (scene.to_bytes(), scene.to_bytes(steps)):
        shown = opened(data)
        for time, angle, distance in ((0.0, 0.3, 3.0), (0.37, 2.0, 2.5), (1.0, 4.0, 1.2)):
            view = camera(angle, distance=distance)
            with torch.no_grad():
                # Not `render`, which leaves what the planes would carry into view from far outside of it where it is.
                background = torch.tensor(model.background)
                drawn = rasterize(replace(view, near=model.near), *model.at(time), background, antialiased=antialiased)
                truth = drawn.color.clamp(0, 1).numpy()
            found.append(psnr(shown.show(view, time), truth))
    assert min(found[:3]) > 45, found
    assert min(found[3:]) > 38, found
    print(motion, antialiased, [round(x, 1) for x in found])
