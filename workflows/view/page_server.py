"""`e4dgs view --player`: serves the page of the web player, whose frames are drawn in the browser and not here."""

from __future__ import annotations

import socket
import sys
import threading
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

from ...scene.model import Model
from ...stages.exports.web import light_web
from ...stages.shared.posed_frameset import PosedFrameSet
from ..player.page import page
from .source import Found

MOST = 1 << 30  # bytes of a scene
DATA = "scene.e4dw"


class PageServer:
    """Serves the page of ``frames`` and the model last given to `show`, until `stop`. A browser that is reloaded gets the newest.

    title: of the page. times: of the capture. host, port: as from `listening`.
    """

    def __init__(self, frames: PosedFrameSet, found: Found, title: str, times: int, host: str, port: int) -> None:
        self.frames, self.title, self.times = frames, title, times
        self.show(found)
        viewer = self

        class Answers(BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                viewer.answer(self)

            def log_message(self, format: str, *arguments: object) -> None:
                """Nothing is said of each request."""

        class Server(ThreadingHTTPServer):
            daemon_threads = True
            address_family = socket.AF_INET6 if ":" in host else socket.AF_INET

            def handle_error(self, request: object, client_address: object) -> None:
                """A page that is closed or loaded again while it is sent is no error; others are shown."""
                if not isinstance(sys.exc_info()[1], ConnectionError):
                    super().handle_error(request, client_address)  # type: ignore[arg-type]

        self.server = Server((host, port), Answers)
        self.port = self.server.server_address[1]
        threading.Thread(target=self.server.serve_forever, daemon=True).start()

    def show(self, found: Found) -> None:
        """Continues with another model."""
        data, text = written(found.model, self.frames, self.title, self.times)
        self.files = {"/": ("text/html; charset=utf-8", text.encode()), f"/{DATA}": ("application/octet-stream", data)}

    def answer(self, request: BaseHTTPRequestHandler) -> None:
        kind, body = self.files.get(request.path.partition("?")[0], ("", b""))
        if not kind:
            request.send_error(HTTPStatus.NOT_FOUND)
            return
        request.send_response(HTTPStatus.OK)
        for name, value in (("Content-Type", kind), ("Content-Length", str(len(body))), ("Cache-Control", "no-store")):
            request.send_header(name, value)
        request.end_headers()
        request.wfile.write(body)

    def stop(self) -> None:
        self.server.shutdown()
        self.server.server_close()


def written(model: Model, frames: PosedFrameSet, title: str, times: int) -> tuple[bytes, str]:
    """The scene's file and its page."""
    made = light_web(model, frames, times, MOST)
    if made is None:
        raise ValueError(f"the scene has more than {MOST >> 20} MB")
    data, poster = made
    return data, page(title, DATA, poster, model.background, times > 1)
