"""`e4dgs export 4dgs CAPTURE`, `e4dgs export ply --freetime`: the whole clip as one file of Gaussians on straight paths."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from rich.console import Console

from ...pipeline import Progress, say
from ..options import of_last_run
from ..session import Options
from .meaning import without
from .trained import Antialiased, Moment, Up, axes_line, check_moment, is_file, open_trained, out_option, up_axis, writing

if TYPE_CHECKING:
    from ...stages.exports.straight.export import Straight

ENDINGS: dict[Straight, str] = {"4dgs": ".4dgs", "freetime": ".ply"}

Out = Annotated[Path | None, out_option("FILE.4dgs|DIR", "Output; by default in scenes/<name>/export/4dgs.")]


@of_last_run("coarse")
@without(times="one file holds the whole clip, so there is no number of files to choose; leave it out, or give --time for one moment")
def container(options: Options, out: Out = None, time: Moment = None, up: Up = None, antialiased: Antialiased = False) -> None:
    """One .4dgs file that plays (gaussian-birth), for players of that open container; convexes become Gaussians."""
    write_straight("4dgs", options, out, time, up, antialiased)


def write_straight(kind: Straight, options: Options, out: Path | None, time: float | None, up: str | None, antialiased: bool) -> None:
    """Writes a file of ``kind`` and prints its size, its axes and how far it is from the model."""
    check_moment(time, None)
    ending = ENDINGS[kind]
    axis, single = up_axis(up), is_file(out, (ending,))
    trained = open_trained(options)
    folder = trained.session.export_folder(out, kind)
    name = trained.session.scene.name
    path = folder if single else folder / (f"{name}.ftgs.ply" if kind == "freetime" else name + ending)

    from ...stages.exports.straight.export import export_straight

    console = Console()
    with Progress(4, "export", console) as bar, writing(path):
        done = export_straight(trained.model, trained.frames, path, trained.times, kind, time, axis, antialiased, bar.advance)
    say(str(done), axes_line(done.turn, trained.frames), f"{kind}: {path}")
