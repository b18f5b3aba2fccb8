"""`e4dgs view CAPTURE`: shows a scene in the browser, finished or while it trains."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Annotated

import typer

from ...pipeline import say
from ...stages.facts import Facts
from ..exports.trained import check_posed
from ..options import of_last_run
from ..session import Options, open_session
from .address import addresses, listening, open_page, over_ssh

if TYPE_CHECKING:
    from .page_server import PageServer
    from .server import Viewer

LOOK_AGAIN = 2.0  # s between two checks for a newer model


@of_last_run("coarse", done=False)
def view(
    options: Options,
    port: Annotated[int, typer.Option("--port", min=1, max=65535, help="Port of the page, or the next free one.")] = 8080,
    host: Annotated[str, typer.Option("--host", help="Address to listen on; 0.0.0.0 lets other machines connect.")] = "127.0.0.1",
    no_browser: Annotated[bool, typer.Option("--no-browser", help="Do not open the page.")] = False,
    player: Annotated[
        bool, typer.Option("--player", help="Serve the page of `export web`: frames are drawn in the browser, not on this machine.")
    ] = False,
    wait: Annotated[bool, typer.Option("--wait", help="Wait for a model that a run is about to make.")] = False,
) -> None:
    """Look at a scene in a browser: any view, any time. Also while it trains. Ends with Ctrl-C."""
    place = listening(host, port)
    session = open_session(options)

    from ...stages.shared.posed_frameset import PosedFrameSet
    from .source import Source

    source = Source(session)
    try:
        while (found := source.newest()) is None:
            if not wait:
                raise source.missing()
            time.sleep(LOOK_AGAIN)
        artifacts = source.frames()
        if artifacts is None:
            raise source.missing()
        frames = PosedFrameSet(artifacts[0], session.job.capture.root, artifacts[1])
        check_posed(options, frames)
        viewer: Viewer | PageServer
        if player:
            from .page_server import PageServer

            times = Facts.of(session.job.capture.facts).times
            viewer = PageServer(frames, found, session.scene.name, times, *place)
        else:
            from .server import Viewer

            viewer = Viewer(frames, found, *place)
        pages = addresses(host, viewer.port)
        also = "".join(f", from other machines {page}" for page in pages[1:])
        say(*filter(None, (f"{found.title}: {pages[0]}{also} (Ctrl-C ends)", over_ssh(host, viewer.port))))
        if not no_browser:
            open_page(pages[0])
        try:
            while True:
                time.sleep(LOOK_AGAIN)
                if not source.final and (newer := source.newest()) is not None:
                    viewer.show(newer)
        finally:
            viewer.stop()
    except KeyboardInterrupt:
        return
