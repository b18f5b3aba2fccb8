"""`e4dgs view --player` serves the page of the web player, and the newest model to whoever opens it again."""

import socket
import struct
import time
import urllib.error
import urllib.request

import pytest
from e4dgs.scene.formats.web.scene import WebScene
from e4dgs.stages.shared.posed_frameset import PosedFrameSet
from e4dgs.workflows.view.address import listening
from e4dgs.workflows.view.page_server import PageServer
from e4dgs.workflows.view.source import Found
from made_models import made
from run_stage import run_frames


@pytest.fixture(scope="module")
def frames(dnerf_capture, tmp_path_factory) -> PosedFrameSet:
    return PosedFrameSet(run_frames(dnerf_capture.root, tmp_path_factory.mktemp("view")).artifact, dnerf_capture.root)


@pytest.fixture
def server(frames):
    found = Found(made("lives", gaussians=80, convexes=8, degree=1), "coarse, step 100")
    server = PageServer(frames, found, "made", 12, *listening("127.0.0.1", 8731))
    yield server
    server.stop()


def read(server: PageServer, path: str) -> tuple[int, str, bytes]:
    try:
        with urllib.request.urlopen(f"http://127.0.0.1:{server.port}{path}", timeout=20) as answer:
            return answer.status, answer.headers["Content-Type"], answer.read()
    except urllib.error.HTTPError as error:
        return error.code, "", b""


def test_the_page_and_its_scene_are_served_and_nothing_else(server):
    status, kind, page = read(server, "/")
    assert (status, kind) == (200, "text/html; charset=utf-8") and b'data-scene="scene.e4dw"' in page
    status, _, data = read(server, "/scene.e4dw")
    assert status == 200 and sum(WebScene.from_bytes(data).header["gaussians"]) > 40
    for path in ("/etc/passwd", "/../page.py", "/scene.e4dw/x"):
        assert read(server, path)[0] == 404
    server.show(Found(made("static", gaussians=50, convexes=4, degree=1), "fine, finished"))
    assert WebScene.from_bytes(read(server, "/scene.e4dw")[2]).header["motion"] == "static"


def test_a_page_that_is_closed_while_it_loads_prints_nothing(server, capfd):
    server.files = {**server.files, "/large": ("application/octet-stream", bytes(1 << 26))}
    ended, end = [], server.server.shutdown_request
    server.server.shutdown_request = lambda request: (end(request), ended.append(request))
    for words in (b"GET /large HTTP/1.1\r\n\r\n", b"GET /lar"):
        with socket.create_connection(("127.0.0.1", server.port)) as page:
            page.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))  # closing it is a reset
            page.sendall(words)
            time.sleep(0.2)
    deadline = time.monotonic() + 20
    while len(ended) < 2 and time.monotonic() < deadline:
        time.sleep(0.05)
    assert len(ended) == 2 and "Traceback" not in capfd.readouterr().err
    server.files["/broken"] = ("text/html", None)
    with pytest.raises(OSError):
        read(server, "/broken")
    assert "TypeError" in capfd.readouterr().err, "other errors are shown"


def test_a_browser_draws_it(server, browser):
    shown = browser.new_page()
    try:
        shown.goto(f"http://127.0.0.1:{server.port}/")
        shown.wait_for_selector("body.ready", timeout=60_000)
        assert shown.evaluate("e4dgs.info.motion") == "lives"
    finally:
        shown.close()
