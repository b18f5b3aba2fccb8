"""`e4dgs export WHAT CAPTURE`: writes stored results as files that other programs read. It computes nothing that a stage computes."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from ...pipeline import CaptureError, Progress, SettingsError, counted, say
from ...stages.exports.numbered import KINDS, SplatFormat
from ..options import of_last_run
from ..results import results
from ..session import Options, open_session
from .cameras import cameras
from .meaning import without
from .mesh import mesh
from .straight import container, write_straight
from .trained import (
    Antialiased,
    Moment,
    Up,
    axes_line,
    check_folder,
    check_moment,
    check_single,
    check_strangers,
    is_file,
    open_trained,
    out_option,
    times_option,
    up_axis,
    writing,
)
from .usd import usd
from .web import web

app = typer.Typer(no_args_is_help=True, help="Write results as files for other programs.")

Out = Annotated[Path | None, out_option("DIR", "Output folder; by default scenes/<name>/export/flow in the workspace.")]
Largest = Annotated[
    float | None, typer.Option("--largest", metavar="PX", help="Motion that gets full colour; by default chosen for the flow.")
]

Times = Annotated[int | None, times_option("Number of files; by default one for each time, at most 60.")]
Target = Annotated[
    Path | None, out_option("FILE|DIR", "A folder, or a file for one time; by default scenes/<name>/export/ in the workspace.")
]


@app.command()
@of_last_run("flow")
@without(
    times="every pair of frames is written; leave it out",
    time="every pair of frames is written; leave it out",
    up="flow lies in pictures, which have no axis of the scene; leave it out",
    antialiased="flow is measured in the frames, not drawn by the model; leave it out",
)
def flow(options: Options, out: Out = None, largest: Largest = None) -> None:
    """Measured flow of every pair of frames as .flo and PNG, with edges and what moves laid over the first frame."""
    if largest is not None and not 0 < largest < float("inf"):
        raise SettingsError(f"--largest {largest}: give a positive number of px")
    check_folder(out)
    for ending in (".flo", ".png"):
        check_strangers(out, ending)
    session = open_session(options)
    found = results(session, "flow")
    artifact, frames = found["flow"], found["frames"]
    assert artifact is not None and frames is not None  # `results` guarantees the first, and no stage runs without the second
    folder = session.export_folder(out, "flow")

    from ...stages.exports.flow import common_largest, export_flow
    from ...stages.flow.artifact import StoredFlow
    from ...stages.shared.posed_frameset import PosedFrameSet

    console = Console()
    fields = StoredFlow(artifact)
    if not fields.pairs:
        why = fields.static_reason or "no two training frames of one camera"
        raise CaptureError(f"{options.capture}: no flow was measured, so there is none to export: {why}")
    largest = largest or common_largest(fields)
    pictures = PosedFrameSet(frames, session.job.capture.root, found.get("poses"))
    with Progress(len(fields.pairs), "export", console) as bar, writing(folder):
        count = export_flow(fields, pictures, folder, largest, bar.advance)
    meaning = f"full colour is {largest:.3g} px, darker means more, black means unknown (wheel.png)"
    say(f"{counted(len(fields.pairs), 'pair')}, {counted(count, 'file')}; {meaning}", f"flow: {folder}")


@app.command()
@of_last_run("coarse")
def ply(
    options: Options,
    out: Target = None,
    times: Times = None,
    time: Moment = None,
    up: Up = None,
    antialiased: Antialiased = False,
    compressed: Annotated[bool, typer.Option("--compressed", help="The compressed layout of PlayCanvas.")] = False,
    freetime: Annotated[bool, typer.Option("--freetime", help="One file for all times, in the layout of FreeTimeGS.")] = False,
) -> None:
    """Numbered .ply files, one for each time, as SuperSplat, Brush and other 3DGS tools read them; convexes become Gaussians."""
    if freetime:
        if compressed or times is not None:
            other = "--compressed" if compressed else "--times"
            raise SettingsError(f"--freetime and {other}: one file of that layout holds all times as they are; leave out {other}")
        write_straight("freetime", options, out, time, up, antialiased)
        return
    _splats("compressed-ply" if compressed else "ply", options, out, times, time, up, antialiased)


def _command(kind: SplatFormat) -> Callable[..., None]:
    """A command that takes the run's options and writes files of ``kind``."""

    @of_last_run("coarse")
    def command(
        options: Options, out: Target = None, times: Times = None, time: Moment = None, up: Up = None, antialiased: Antialiased = False
    ) -> None:
        _splats(kind, options, out, times, time, up, antialiased)

    return command


app.command("spz", help="Numbered .spz files (Niantic), a fifth of the size of .ply or less.")(_command("spz"))
app.command("sog", help="Numbered .sog files (PlayCanvas), for the web.")(_command("sog"))
app.command("gltf", help="Numbered .glb files with KHR_gaussian_splatting, for engines and web viewers.")(_command("gltf"))
app.command()(web)
app.command("4dgs")(container)
app.command()(usd)
app.command()(mesh)
app.command()(cameras)


def _splats(
    kind: SplatFormat, options: Options, out: Path | None, times: int | None, time: float | None, up: str | None, antialiased: bool
) -> None:
    """Writes the Gaussians of each time as files of ``kind``, and prints their axes and how far they are from the model."""
    ending = "." + KINDS[kind].rpartition(".")[2]  # of .compressed.ply, too
    check_moment(time, times)
    axis, single = up_axis(up), is_file(out, (ending,))
    trained = open_trained(options)

    from ...stages.exports.splats import export_splats

    moments = trained.chosen(times, time)
    if single and out is not None:
        check_single(out, len(moments), ending)
    else:
        check_strangers(out, KINDS[kind])
    target = trained.session.export_folder(out, kind)
    console = Console()
    with Progress(len(moments), "export", console) as bar, writing(target):
        done = export_splats(trained.model, trained.frames, target, moments, kind, single, axis, antialiased, bar.advance)
    each = counted(done.most, "Gaussian") if done.fewest == done.most else f"{done.fewest} to {done.most} Gaussians"
    files = f"{len(moments)} files, {each} each" if len(moments) > 1 else each
    notes = *trained.thinned(len(moments), times), *(f"note: {note}" for note in done.notes)
    say(f"{files}; {done.loss}", *notes, axes_line(done.turn, trained.frames), f"{kind}: {target}")
