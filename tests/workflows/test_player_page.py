"""The web player in a real Chromium draws what the rasterizer draws, of every motion, and survives what happens to pages."""

import base64
import io
import os
from dataclasses import replace

import numpy as np
import pytest
import torch
from e4dgs.rasterizer import Camera, rasterize
from e4dgs.scene.formats.web.container import header_of
from e4dgs.stages.exports.web_scene import web_scene
from e4dgs.workflows.exports.web import address_of, write_data
from e4dgs.workflows.player.page import page
from made_models import FRAMES, MOTIONS, camera, made
from PIL import Image

ABOUT = {"seconds": 1.0, "up": [0.0, -1.0, 0.0], "target": [0.0, 0.0, 0.0]}
PIXEL = 3.0 / 150


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

    def __init__(self, browser, folder, data: bytes, play=False, poster=None, size=(500, 400), cut=len, before="", address=""):
        self.file = folder / "scene.html"
        text = page("made", data, poster, (1.0, 0.9, 0.8), play)
        written = text[: cut(text)]
        self.file.write_text(written)
        self.page = browser.new_page(viewport={"width": size[0], "height": size[1]})
        if before:
            self.page.add_init_script(before)
        self.outside, self.errors, self.said = [], [], []
        self.page.on("console", lambda message: self.said.append(message.text))
        self.page.on("request", lambda asked: self.outside.append(asked.url))
        self.page.on("pageerror", lambda error: self.errors.append(str(error)))
        self.page.goto(self.file.as_uri() + address)
        if len(written) >= text.index('<script type="text/plain" id="scene">'):  # a script that was cut does not run
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
        return decoded(self.page.evaluate("e4dgs.canvas.toDataURL('image/png')"))


@pytest.fixture
def opened(browser, tmp_path):
    pages = []

    def open_it(*arguments, **more):
        pages.append(Page(browser, tmp_path, *arguments, **more))
        return pages[-1]

    yield open_it
    for one in pages:
        one.page.close()
        asked = [url for url in one.outside if url.partition("#")[0] != one.file.as_uri() and not url.startswith(("blob:", "data:"))]
        assert not asked, "nothing is asked of others"


def psnr(a, b):
    return float(-10 * np.log10(max(np.square(a - b).mean(), 1e-10)))


@pytest.mark.parametrize(("motion", "antialiased"), [*((motion, True) for motion in MOTIONS), ("static", False)])
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


@pytest.fixture(scope="module")
def file() -> bytes:
    scene, steps = web_scene(made("lives", gaussians=150, convexes=20, degree=1), FRAMES, PIXEL, about(3))
    return scene.to_bytes(steps)


def time_of(shown: Page) -> float:
    return float(shown.page.input_value("#time"))


def visible(shown: Page, name: str) -> bool:
    return shown.page.locator(name).is_visible()


def test_the_page_plays_and_its_controls_work(opened, file):
    shown = opened(file, play=True)
    page = shown.page
    info = page.evaluate("e4dgs.info")
    assert (info["gaussians"] + info["convexes"] > 100, info["motion"], info["duration"], info["bytes"]) == (True, "lives", 1.0, len(file))
    page.click("#play")
    stopped = time_of(shown)
    assert stopped > 0, "it played by itself"
    page.evaluate("e4dgs.play()")
    page.wait_for_timeout(800)
    page.evaluate("e4dgs.pause()")
    assert time_of(shown) != stopped
    page.locator("#time").fill("0.5")
    page.wait_for_timeout(600)
    still = shown.picture()
    page.select_option("#photo", "2")
    page.wait_for_timeout(600)
    other = shown.picture()
    assert psnr(other, still) < 30
    page.locator("#canvas").focus()
    page.keyboard.press("ArrowLeft")
    page.keyboard.press("KeyO")
    assert page.inner_text("#mode") == "Fly"
    page.wait_for_timeout(600)
    turned = shown.picture()
    assert psnr(turned, other) < 40
    uploads = page.evaluate("e4dgs.info.uploads")
    page.wait_for_timeout(500)
    assert page.evaluate("e4dgs.info.uploads") == uploads, "nothing is uploaded while nothing changes"
    box = page.locator("#canvas").bounding_box()
    page.mouse.move(box["x"] + 100, box["y"] + 100)
    page.mouse.down()
    page.mouse.move(box["x"] + 180, box["y"] + 120, steps=3)
    page.mouse.up()
    page.mouse.wheel(0, 300)
    page.wait_for_timeout(900)
    assert psnr(shown.picture(), turned) < 40
    assert not shown.errors


def test_escape_closes_the_list_of_keys_and_opens_nothing(opened, file):
    shown = opened(file)
    page, listed = shown.page, lambda: visible(shown, "#keys")
    for focused in ("#canvas", "#photo", "#help"):
        page.locator("#canvas").focus()
        page.keyboard.press("KeyH")
        assert listed()
        page.locator(focused).focus()
        page.keyboard.press("Escape")
        assert not listed(), focused
        page.keyboard.press("Escape")
        assert not listed(), focused
    page.click("#help")
    assert listed() and not shown.errors


def test_without_a_graphics_device_the_first_picture_is_coarse_and_the_next_has_all_pixels(opened, file):
    watch = """
        window.widths = [];
        const note = (all) => all.forEach(({ target }) => target.id === "canvas" && widths.push(target.width));
        new MutationObserver(note).observe(document, { subtree: true, attributes: true, attributeFilter: ["width"] });
    """
    page = opened(file, before=watch).page
    for _ in range(100):
        if page.evaluate("e4dgs.canvas.width") == 500:
            break
        page.wait_for_timeout(100)
    assert page.evaluate("widths") == [200, 500]


def test_layers_have_the_names_of_the_live_viewer_and_show_their_primitives(opened, file):
    from e4dgs.workflows.view.looks import PRIMITIVES

    shown = opened(file)
    assert shown.page.locator("#layer option").all_inner_texts() == list(PRIMITIVES)
    pictures = []
    for layer in PRIMITIVES:
        shown.page.select_option("#layer", layer)
        shown.page.wait_for_timeout(700)
        pictures.append(shown.picture())
    assert min(psnr(one, other) for k, one in enumerate(pictures) for other in pictures[:k]) < 40
    assert all(psnr(pictures[0], other) < 45 for other in pictures[1:])


# A headset of two eyes, 64 mm apart, whose pictures lie side by side on the canvas.
HEADSET = """
window.frames_ = [], window.sessions = [];
WebGL2RenderingContext.prototype.makeXRCompatible = async () => {};
const size = () => ({ width: 120, height: 160 });
const eye = (x) => ({ projectionMatrix: [1.5,0,0,0, 0,1.1,0,0, 0,0,-1,-1, 0,0,-0.1,0], side: x,
  transform: { inverse: { matrix: [1,0,0,0, 0,1,0,0, 0,0,1,0, -x,0,0,1] } } });
class Session extends EventTarget {
  constructor() { super(), sessions.push(this); }
  updateRenderState() {}
  async requestReferenceSpace() { return {}; }
  requestAnimationFrame(act) { frames_.push(act); }
  async end() { this.dispatchEvent(new Event("end")); }
}
Object.defineProperty(navigator, "xr", { value: { isSessionSupported: async () => true, requestSession: async () => new Session() } });
window.XRWebGLLayer = class { framebuffer = null; getViewport(view) { return { x: view.side < 0 ? 0 : 120, y: 20, ...size() }; } };
window.step = (now) => frames_.splice(0).forEach((act) => act(now, { getViewerPose: () => ({ views: [eye(-0.032), eye(0.032)] }) }));
"""


def test_a_headset_gets_a_picture_for_each_eye(opened, file):
    plain = opened(file)
    plain.page.wait_for_timeout(200)
    assert not visible(plain, "#stereo"), "no headset, no button"
    shown = opened(file, before=HEADSET, size=(500, 400))
    shown.page.locator("#stereo").wait_for(timeout=10_000)
    shown.page.click("#stereo")
    for now in (0, 16, 32):
        shown.page.wait_for_timeout(400)
        shown.page.evaluate(f"step({now})")
    both = shown.picture()
    foot = len(both) - 20  # rows of a viewport count from its foot
    eyes = both[foot - 160 : foot, :120], both[foot - 160 : foot, 120:240]
    shown.page.evaluate("document.getElementById('stereo').click()")
    shown.page.wait_for_timeout(600)
    assert visible(shown, "#bar") and shown.picture().shape == (400, 500, 3) and not shown.errors, "the page goes on"
    for x, eye in zip((-0.032, 0.032), eyes):
        assert psnr(eye, shown.show(eye_of(camera(0.0), x), 0.0)) > 45
    assert psnr(*eyes) < 35


def test_the_address_chooses_camera_time_and_controls(opened, file):
    shown = opened(file, play=True, address="#time=0.3&camera=2&play=0&controls=0&speed=9")
    page = shown.page
    page.wait_for_timeout(600)
    drawn = shown.picture()
    assert (time_of(shown), page.input_value("#photo"), page.get_attribute("#play", "aria-label")) == (0.3, "1", "Play")
    assert not visible(shown, "#bar") and [text for text in shown.said if "speed=9" in text]
    page.keyboard.press("KeyF")
    page.wait_for_selector("html:fullscreen")
    assert not visible(shown, "#bar")
    page.keyboard.press("KeyF")
    page.keyboard.press("KeyH")
    page.keyboard.press("KeyC")
    assert visible(shown, "#bar") and visible(shown, "#keys")
    page.keyboard.press("KeyC")
    assert not visible(shown, "#bar") and not visible(shown, "#keys")
    page.evaluate("location.hash = '#controls=1&time=0.6&camera=1'")
    page.wait_for_timeout(600)
    assert (time_of(shown), page.input_value("#photo"), visible(shown, "#bar")) == (0.6, "0", True)
    assert psnr(shown.picture(), drawn) < 40 and not shown.errors
    playing = opened(file, address="#play=1")
    playing.page.wait_for_timeout(600)
    assert time_of(playing) > 0


NO_SCREEN = """
Object.defineProperty(Document.prototype, "fullscreenEnabled", { value: undefined });
delete Element.prototype.requestFullscreen;
"""
REFUSES = """
Element.prototype.requestFullscreen = async () => { throw new TypeError("not here"); };
navigator.xr.requestSession = async () => { throw new Error("The headset is asleep."); };
"""


def test_what_a_browser_refuses_is_said_and_the_message_ends(opened, file):
    shown = opened(file, before=NO_SCREEN)
    assert not visible(shown, "#full")
    message = shown.page.locator("#message")
    shown.page.keyboard.press("KeyF")
    assert visible(shown, "#message") and "may not fill the screen" in message.inner_text()
    message.wait_for(state="hidden", timeout=20_000)
    assert not shown.errors
    shown = opened(file, before=HEADSET + REFUSES)
    message = shown.page.locator("#message")
    for button, words in (("#full", "may not fill the screen"), ("#stereo", "asleep")):
        shown.page.click(button)
        shown.page.locator("#message", has_text=words).wait_for(timeout=10_000)
    message.wait_for(state="hidden", timeout=20_000)
    assert not shown.errors


def eye_of(view: Camera, x: float) -> Camera:
    """The camera of an eye ``x`` metres to the right of ``view``, which is levelled; the origin, at which it looks, is 2 m away."""
    pose, up = view.cam_from_world.double().numpy(), np.array(ABOUT["up"])
    place = -pose[:3, :3].T @ pose[:3, 3]
    ahead = pose[2, :3] - (pose[2, :3] @ up) * up
    ahead /= np.linalg.norm(ahead)
    rows = np.stack([np.cross(ahead, up), -up, ahead])
    shift = -rows @ place - np.array([x * np.linalg.norm(place) / 2, 0, 0])
    whole = np.eye(4)
    whole[:3] = np.concatenate([rows, shift[:, None]], 1)
    lens = torch.tensor([[1.5 * 60, 0, 60], [0, 1.1 * 80, 80], [0, 0, 1.0]])
    return Camera(lens, torch.tensor(whole), 120, 160)


def test_a_picture_that_was_asked_for_has_nothing_over_it(opened, file):
    shown = opened(file)
    view = camera(0.2, 90, 70)
    picture = shown.show(view, 0.4)
    assert picture.shape == (70, 90, 3) and not visible(shown, "#bar")
    cut = np.asarray(Image.open(io.BytesIO(shown.page.locator("#canvas").screenshot())).convert("RGB")) / 255
    assert np.abs(cut - picture).max() <= 1 / 255
    shown.page.evaluate("e4dgs.pause()")
    assert visible(shown, "#bar")


GOOD = "{time: 0, cam_from_world: [1,0,0,0, 0,1,0,0, 0,0,1,3, 0,0,0,1], K: [90,0,45, 0,90,35, 0,0,1], width: 90, height: 70}"
REFUSED = {
    "{}": "TypeError: show: time must be",
    f"{{...{GOOD}, time: NaN}}": "TypeError: show: time must be",
    f"{{...{GOOD}, cam_from_world: []}}": "TypeError: show: cam_from_world must be 16 finite numbers",
    f"{{...{GOOD}, cam_from_world: Array(16).fill(0)}}": "TypeError: show: cam_from_world must be a rotation",
    f"{{...{GOOD}, cam_from_world: [2,0,0,0, 0,2,0,0, 0,0,2,3, 0,0,0,1]}}": "TypeError: show: cam_from_world must be a rotation",
    f"{{...{GOOD}, cam_from_world: [-1,0,0,0, 0,1,0,0, 0,0,1,3, 0,0,0,1]}}": "TypeError: show: cam_from_world must be a rotation",
    f"{{...{GOOD}, cam_from_world: [1,0,0,Infinity, 0,1,0,0, 0,0,1,3, 0,0,0,1]}}": "TypeError: show: cam_from_world must be 16 finite",
    f"{{...{GOOD}, K: [0,0,45, 0,90,35, 0,0,1]}}": "TypeError: show: the focal lengths in K must be positive",
    f"{{...{GOOD}, K: [90,3,45, 0,90,35, 0,0,1]}}": "TypeError: show: K must be fx 0 cx",
    f"{{...{GOOD}, width: 90.5}}": "TypeError: show: width and height must be whole",
    f"{{...{GOOD}, height: 0}}": "TypeError: show: width and height must be whole",
    f"{{...{GOOD}, width: 1e6}}": "RangeError: show: 1000000x70 px is more than this device draws",
}


def test_a_view_that_is_none_is_refused_and_changes_nothing(opened, file):
    shown = opened(file)
    assert shown.page.evaluate(f"e4dgs.show({GOOD}).then(() => 'drawn')") == "drawn"
    before = shown.picture()
    for view, words in REFUSED.items():
        said = shown.page.evaluate(f"e4dgs.show({view}).then(() => 'drawn', (error) => String(error))")
        assert said.startswith(words), (view, said)
    assert np.array_equal(shown.picture(), before) and not shown.errors


def test_a_lost_graphics_device_comes_back_with_the_same_picture(opened, file):
    shown = opened(file)
    before = shown.show(camera(0.2), 0.4)
    shown.page.evaluate("window.lost = e4dgs.canvas.getContext('webgl2').getExtension('WEBGL_lose_context'), lost.loseContext()")
    shown.page.wait_for_timeout(300)
    shown.page.evaluate("lost.restoreContext()")
    shown.page.wait_for_timeout(1500)
    assert np.array_equal(shown.picture(), before)
    assert np.array_equal(shown.show(camera(0.2), 0.4), before) and not shown.errors
    shown.page.evaluate("lost.loseContext(), setTimeout(() => lost.restoreContext(), 600)")
    assert np.array_equal(shown.show(camera(0.2), 0.4), before), "it waits for the device"


def small_buffer(most: int) -> str:
    """A browser whose drawing buffers have at most ``most`` px a row, whatever the canvas asks for."""
    width = f"get() {{ return Math.min(this.canvas.width, {most}); }}"
    return f"Object.defineProperty(WebGL2RenderingContext.prototype, 'drawingBufferWidth', {{ {width} }});"


SMALL_DEVICE = """
const given = WebGL2RenderingContext.prototype.getParameter;
WebGL2RenderingContext.prototype.getParameter = function (name) { return name === this.MAX_TEXTURE_SIZE ? 256 : given.call(this, name); };
"""


@pytest.mark.parametrize(("before", "most"), [(SMALL_DEVICE, 256), (small_buffer(300), 300), (small_buffer(90), 90)])
def test_a_device_of_small_pictures_gets_smaller_ones(opened, file, before, most):
    shown = opened(file, before=before)
    shown.page.wait_for_timeout(1000)
    width = shown.page.evaluate("e4dgs.canvas.width")
    assert most / 2 <= width <= most and visible(shown, "#bar") and not shown.errors
    shown.page.keyboard.press("ArrowLeft")
    shown.page.wait_for_timeout(800)
    assert most / 2 <= shown.page.evaluate("e4dgs.canvas.width") <= most and not visible(shown, "#message")


def test_a_frame_that_fails_once_is_drawn_again_and_one_that_always_fails_ends_the_player(opened, file):
    fails = "const draw = WebGL2RenderingContext.prototype; window.failing = 0; window.whole = draw.drawElements;"
    fails += "draw.drawElements = function (...all) { if (failing-- > 0) throw new Error('no picture'); return whole.apply(this, all); };"
    shown = opened(file, before=fails)
    shown.page.wait_for_timeout(600)
    before = shown.picture()
    shown.page.evaluate("failing = 2")
    shown.page.keyboard.press("ArrowLeft")
    shown.page.wait_for_timeout(800)
    assert shown.picture().shape == before.shape and psnr(shown.picture(), before) < 40
    assert not visible(shown, "#message") and visible(shown, "#bar")
    shown.page.evaluate("failing = Infinity")
    shown.page.keyboard.press("ArrowLeft")
    shown.page.locator("body.failed").wait_for(timeout=10_000)
    assert shown.page.inner_text("#message") == "no picture" and not visible(shown, "#bar")


def test_a_graphics_device_that_does_not_come_back_asks_for_a_reload(opened, file):
    shown = opened(file)
    shown.page.evaluate("e4dgs.canvas.getContext('webgl2').getExtension('WEBGL_lose_context').loseContext()")
    shown.page.locator("#message", has_text="waiting for it").wait_for(timeout=4000)
    shown.page.locator("#message", has_text="Reload the page").wait_for(timeout=15_000)


@pytest.mark.parametrize("damage", [lambda d: d[: len(d) // 2], lambda d: b"x" + d[1:], lambda d: d.replace(b"lives", b"dance", 1)])
def test_a_damaged_scene_gives_a_message(opened, file, damage):
    shown = opened(damage(file))
    assert visible(shown, "#message") and "scene" in shown.page.inner_text("#message").lower() and not visible(shown, "#bar")
    assert "Error" in shown.page.evaluate("e4dgs.ready.catch((error) => String(error))")


DATA = '<script type="text/plain" id="scene">'
CUTS = {
    "in the poster": lambda text: text.index("base64,") + 2000,
    "in the script": lambda text: text.index("<script>") + 5000,
    "before the data": lambda text: text.index(DATA),
    "in their tag": lambda text: text.index(DATA) + 20,
    "in the data": lambda text: text.index(DATA) + 3000,
    "in the last of them": lambda text: text.rindex("</script>") - 5,
}


@pytest.mark.parametrize("where", CUTS)
def test_a_page_that_was_cut_short_says_so(opened, file, where):
    shown = opened(file, cut=CUTS[where], poster=bytes(3000))
    assert visible(shown, "#message") and "cut short" in shown.page.inner_text("#message") and not shown.errors


def test_no_code_comes_from_text_and_nothing_leaves_the_page(opened, file):
    shown = opened(file)
    said = "(() => { try { return new Function('return 1')(); } catch (error) { return error.name; } })()"
    # Through the page's own timer, since what a debugger evaluates may do more.
    shown.page.evaluate(f"window.found = null; setTimeout(() => {{ window.found = {said}; }})")
    shown.page.wait_for_timeout(200)
    assert shown.page.evaluate("found") == "EvalError"
    assert shown.page.evaluate("fetch('https://example.invalid/').then(() => 'sent', () => 'refused')") == "refused"
    shown.outside = [url for url in shown.outside if "example.invalid" not in url]


@pytest.mark.parametrize("width", [390, 1440])
def test_controls_fit_narrow_and_wide_windows(opened, file, width):
    shown = opened(file, size=(width, 700))
    assert shown.page.evaluate("document.documentElement.scrollWidth") <= width
    for name in ("#play", "#time", "#speed", "#loop", "#photo", "#layer", "#mode", "#full", "#help"):
        box = shown.page.locator(name).bounding_box()
        assert box["x"] >= 0 and box["x"] + box["width"] <= width and box["y"] + box["height"] <= 700, name
        assert width > 700 or min(box["width"], box["height"]) >= 16


def test_a_site_that_forbids_workers_shows_the_scene(browser, file):
    shown, address = browser.new_page(), "http://player.test/"
    headers = {"content-type": "text/html", "content-security-policy": "worker-src 'none'"}
    shown.route(address, lambda asked: asked.fulfill(body=page("made", file, None, (1, 1, 1), False), headers=headers))
    try:
        shown.goto(address)
        shown.wait_for_selector("body.ready", timeout=60_000)
    finally:
        shown.close()


@pytest.fixture
def served(browser, tmp_path):
    """Serves a folder: (page, folder, address, held). A file whose name is in ``held`` is answered when it no longer is."""
    import threading
    import time
    from functools import partial
    from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer

    held = set()

    class Quiet(SimpleHTTPRequestHandler):
        def log_message(self, *arguments):
            pass

        def do_GET(self):
            while self.path[1:] in held:
                time.sleep(0.02)
            super().do_GET()

    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(Quiet, directory=str(tmp_path)))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    shown = browser.new_page(viewport={"width": 500, "height": 400})
    yield shown, tmp_path, f"http://127.0.0.1:{server.server_port}/index.html", held
    held.clear()
    shown.close()
    server.shutdown()


def test_a_page_without_https_says_why_it_has_no_headset(served, opened, file):
    shown, folder, address, _ = served
    (folder / "index.html").write_text(page("plain", file, None, (1, 1, 1), False))
    shown.route("http://player.test/", lambda asked: asked.fulfill(path=folder / "index.html"))
    for site, said in (("http://player.test/", True), (address, False)):  # localhost is as good as https
        shown.goto(site)
        shown.wait_for_selector("body.ready", timeout=60_000)
        shown.keyboard.press("KeyH")
        assert ("needs https" in shown.inner_text("#keys")) == said, site
    assert not visible(opened(file), ".unsafe >> nth=0")


def test_a_headset_waits_for_windows_and_its_trigger_plays(served, long_clip):
    shown, folder, address, held = served
    shown.add_init_script(HEADSET)
    (folder / "index.html").write_text(page("apart", "scene.e4dw", None, (1, 1, 1), False))
    write_data(folder / "scene.e4dw", long_clip)
    held |= {"scene-2.e4dw", "scene-3.e4dw", "scene-4.e4dw"}
    shown.goto(address)
    shown.wait_for_selector("body.ready", timeout=60_000)
    shown.locator("#stereo").click()
    wait = "(async () => {{ while (!({})) await new Promise((done) => setTimeout(done, 50)); }})()"
    shown.evaluate(wait.format("frames_.length"))
    frames, trigger = "for (let k = 0; k < 20; ++k) step(start + 400 * k)", "sessions[0].dispatchEvent(new Event('select'))"
    shown.evaluate("start = 0, " + trigger)
    shown.evaluate(f"{{ {frames} }}")
    first = float(shown.input_value("#time"))
    start = header_of((folder / "scene.e4dw").read_bytes())[0]["windows"][1][0]
    assert 0 < first < start + 0.07, "it plays until the window that is on its way"
    held.clear()
    shown.evaluate(wait.format(f"e4dgs.info.bytes >= {sum(path.stat().st_size for path in folder.glob('*.e4dw'))}"))
    shown.wait_for_timeout(300)
    shown.evaluate(f"{{ start = 8000; step(start); step(start + 400); {trigger}; {frames.replace('start +', 'start + 800 +')} }}")
    assert first < float(shown.input_value("#time")) < first + 0.16, "the trigger has stopped it"


def test_page_and_data_apart_need_a_server(served, file):
    shown, folder, address, _ = served
    (folder / "index.html").write_text(page("apart", address_of(file), None, (1, 1, 1), False))
    (folder / "scene.e4dw").write_bytes(file)
    shown.goto(address)
    shown.wait_for_selector("body.ready", timeout=60_000)
    shown.goto((folder / "index.html").as_uri())
    shown.wait_for_selector("body.failed", timeout=60_000)
    said = shown.inner_text("#message")
    assert "from a web server only" in said and "(scene.e4dw)" in said


@pytest.fixture(scope="module")
def long_clip() -> bytes:
    """Eight seconds, in which two of three movers are seen for half a second or less: four windows beside the first file."""
    model = made("lives", gaussians=300, convexes=40, degree=1)
    with torch.no_grad():
        for one in (model.gaussians, model.convexes):
            one.log_spans[torch.arange(len(one)) % 3 > 0] -= 3.5
    scene, steps = web_scene(model, FRAMES, PIXEL, about(3) | {"seconds": 8.0})
    return scene.to_bytes(steps)


TIMES = 0.0, 0.41, 0.55, 0.96  # in each of four windows, and not in the reach of another


def wanted(time: float) -> dict:
    """What `e4dgs.show` takes."""
    view = camera(0.3, distance=2.5)
    return {name: getattr(view, name).flatten().tolist() for name in ("cam_from_world", "K")} | {
        "time": time,
        "width": view.width,
        "height": view.height,
    }


def pictures(shown, times=TIMES) -> list:
    """What is drawn at each of ``times``, or why it is not."""
    draw = "view => e4dgs.show(view).then(() => e4dgs.canvas.toDataURL('image/png'), (error) => error.message)"
    said = [shown.evaluate(draw, wanted(time)) for time in times]
    return [decoded(one) if one.startswith("data:") else one for one in said]


def decoded(png: str) -> np.ndarray:
    return np.asarray(Image.open(io.BytesIO(base64.b64decode(png.split(",")[1]))).convert("RGB")) / 255


def test_windows_draw_what_the_single_file_draws_and_wait_for_their_times(served, opened, long_clip):
    shown, folder, address, held = served
    truth = pictures(opened(long_clip).page)
    (folder / "index.html").write_text(page("apart", "scene.e4dw", None, (1, 1, 1), True))
    write_data(folder / "scene.e4dw", long_clip)
    held |= {"scene-2.e4dw", "scene-4.e4dw"}
    shown.goto(address)
    shown.wait_for_selector("body.ready", timeout=60_000)
    shown.wait_for_timeout(4000)
    start = header_of((folder / "scene.e4dw").read_bytes())[0]["windows"][1][0]
    assert start < 0.4 and 0 < float(shown.input_value("#time")) < start + 0.07, "it plays until the window that is on its way"
    assert np.abs(pictures(shown, TIMES[:1])[0] - truth[0]).max() <= 1 / 255
    held.remove("scene-2.e4dw")
    shown.evaluate("e4dgs.pause()")
    shown.locator("#time").fill("0.96")
    shown.evaluate("view => { window.asked = e4dgs.show(view).then(() => { window.drew = true; }); }", wanted(0.96))
    shown.wait_for_timeout(1000)
    assert shown.evaluate("window.drew") is None
    held.clear()
    shown.evaluate("asked")
    for drawn, true in zip(pictures(shown), truth):
        assert np.abs(drawn - true).max() <= 1 / 255
    assert shown.evaluate("e4dgs.info.bytes") == sum(path.stat().st_size for path in folder.glob("*.e4dw"))
    assert not shown.locator("#message").is_visible()
    shown.evaluate("window.lost = e4dgs.canvas.getContext('webgl2').getExtension('WEBGL_lose_context'), lost.loseContext()")
    shown.evaluate("setTimeout(() => lost.restoreContext(), 300)")
    assert np.abs(pictures(shown, TIMES[3:])[0] - truth[3]).max() <= 1 / 255


def test_a_new_export_to_the_same_site_is_fetched_anew(served, long_clip):
    shown, folder, address, _ = served
    later = web_scene(made("lives", gaussians=90, convexes=10, degree=1), FRAMES, PIXEL, about() | {"seconds": 8.0})[0].to_bytes()
    for data in (long_clip, later):
        write_data(folder / "scene.e4dw", data)
        for path in folder.glob("*.e4dw"):
            os.utime(path, (1e9, 1e9))  # a browser keeps for long what has not changed for long
        (folder / "index.html").write_text(page("apart", address_of(data), None, (1, 1, 1), False))
        shown.goto(address)
        shown.wait_for_selector("body.ready", timeout=60_000)
        assert not isinstance(pictures(shown, (0.96,))[0], str), "the windows belong to the scene"
        whole = sum(path.stat().st_size for path in folder.glob("*.e4dw"))
        shown.evaluate(f"(async () => {{ while (e4dgs.info.bytes < {whole}) await new Promise((done) => setTimeout(done, 50)); }})()")
        assert shown.evaluate("e4dgs.info.bytes") == whole


@pytest.mark.parametrize("damage", [lambda path: path.unlink(), lambda path: path.write_bytes(path.read_bytes()[:-30])])
def test_a_window_that_cannot_be_had_is_named_and_the_rest_plays(served, opened, long_clip, damage):
    shown, folder, address, _ = served
    truth = pictures(opened(long_clip).page)
    (folder / "index.html").write_text(page("apart", "scene.e4dw", None, (1, 1, 1), True))
    write_data(folder / "scene.e4dw", long_clip)
    damage(folder / "scene-3.e4dw")
    shown.goto(address)
    shown.wait_for_selector("body.ready", timeout=60_000)
    shown.locator("#message", has_text="scene-3.e4dw").wait_for(timeout=20_000)
    found = pictures(shown)
    assert "scene-3.e4dw" in found[2]
    for k in (0, 1, 3):
        assert np.abs(found[k] - truth[k]).max() <= 1 / 255, k
    before = float(shown.input_value("#time"))
    shown.evaluate("e4dgs.play()")
    shown.wait_for_timeout(1000)
    assert float(shown.input_value("#time")) != before


def test_the_command_writes_a_page_that_plays(finished_run, browser, tmp_path, capsys):
    import tiny_run
    from e4dgs.workflows.cli import main

    capture, workspace = finished_run
    out = tmp_path / "scene.html"
    words = ["export", "web", str(capture.root), "--workspace", str(workspace), *tiny_run.QUICK]
    assert main([*words, "--out", str(out)]) == 0
    said = capsys.readouterr().out
    assert "dB from the model" in said and "MB a second" in said and f"web: {out}" in said
    shown = browser.new_page()
    shown.goto(out.as_uri())
    shown.wait_for_selector("body.ready", timeout=60_000)
    assert shown.evaluate("e4dgs.info.cameras") > 0
    shown.close()
    assert main([*words, "--out", str(tmp_path / "folder")]) == 0
    assert sorted(path.name for path in (tmp_path / "folder").iterdir()) == ["index.html", "scene.e4dw"]
    assert main([*words, "--out", str(tmp_path / "scene.txt")]) == 2


def test_a_run_ends_with_a_page_that_plays(finished_run, browser):
    page = next((finished_run[1] / "scenes").glob("*/player.html"))
    shown = browser.new_page()
    try:
        shown.goto(page.as_uri())
        shown.wait_for_selector("body.ready", timeout=60_000)
        assert shown.evaluate("e4dgs.info.gaussians") > 0
    finally:
        shown.close()


def test_the_report_plays_the_scene(finished_run, browser):
    workspace = finished_run[1]
    report = next((workspace / "scenes").glob("*/report.html"))
    shown = browser.new_page()
    try:
        shown.goto(report.as_uri())
        shown.locator("iframe.player").scroll_into_view_if_needed()
        inside = shown.frame_locator("iframe.player")
        inside.locator("body.ready").wait_for(timeout=60_000)
        inside.locator("#play").click()
        shown.wait_for_timeout(1000)
        assert float(inside.locator("#time").input_value()) > 0
    finally:
        shown.close()
