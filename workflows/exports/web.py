"""`e4dgs export web CAPTURE`: writes the scene as a page that plays in any browser."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Annotated

from rich.console import Console

from ...pipeline import Progress, SettingsError, say
from ...pipeline.files import write_atomically
from ..options import of_last_run
from ..session import Options
from .meaning import without
from .trained import check_posed, is_file, open_trained, out_option, writing

ENDINGS = (".html", ".htm")
PAGE, DATA = "index.html", "scene.e4dw"

Out = Annotated[
    Path | None,
    out_option(
        "FILE.html|DIR",
        "One page with everything in it, or a folder with page and data apart, for a web server; by default a page in "
        "scenes/<name>/export/web.",
    ),
]


def write_data(path: Path, data: bytes) -> int:
    """Writes the scene's file as ``path``, its windows beside it, and removes older ones. Returns the first one's bytes."""
    from ...scene.formats.web.windows import file_of, split

    first, *windows = split(data)
    for k, window in enumerate(windows, 1):
        write_atomically(file_of(path, k), window)
    write_atomically(path, first)
    k = len(windows) + 1
    while file_of(path, k).exists():
        file_of(path, k).unlink()
        k += 1
    return len(first)


def address_of(data: bytes) -> str:
    """Where the page finds the scene of ``data``. The digest makes browsers fetch a new export and its windows."""
    return f"{DATA}?{hashlib.sha256(data).hexdigest()[:12]}"


@of_last_run("coarse")
@without(
    times="the page plays all times of the capture; leave it out",
    time="the page plays all times of the capture, and has a slider; leave it out",
    up="the page turns the scene itself; leave it out",
    antialiased="the page draws the model as it was trained; leave it out",
)
def web(options: Options, out: Out = None) -> None:
    """A page that plays the scene in any browser: any view, any time, from one file without a server."""
    single = is_file(out, ENDINGS) or out is None
    trained = open_trained(options)
    check_posed(options, trained.frames)
    scene = trained.session.scene.name
    target = trained.session.export_folder(out, "web")
    path = target / f"{scene}.html" if out is None else target if single else target / PAGE

    if not single and path.exists() and not (target / DATA).exists():
        raise SettingsError(f"--out {target}: it has {PAGE}, which is no page of this command; name another folder")

    from ...stages.exports.web import export_web
    from ..player.page import page

    console = Console()
    with Progress(3, "export", console) as bar, writing(path):
        made = export_web(trained.model, trained.frames, trained.times, bar.advance)
        if not single:
            first = write_data(target / DATA, made.data)
        where = made.data if single else address_of(made.data)
        text = page(scene, where, made.poster, trained.model.background, made.header["motion"] != "static")
        write_atomically(path, text)
    size = f"page of {len(text) / 1e6:.2f} MB" + ("" if single else f" beside {DATA}, of which {first / 1e6:.2f} MB come first")
    say(f"{made}; {size}", f"web: {path}")
