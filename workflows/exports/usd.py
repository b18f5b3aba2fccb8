"""`e4dgs export usd CAPTURE`: writes the model over time as one USD file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from rich.console import Console

from ...pipeline import Progress, counted, say
from ..options import of_last_run
from ..session import Options
from .trained import Antialiased, Moment, Up, axes_line, check_moment, is_file, open_trained, out_option, times_option, up_axis, writing

ENDINGS = (".usdc", ".usda", ".usd")

Out = Annotated[Path | None, out_option("FILE.usd|FILE.usdc|FILE.usda|DIR", "Output; by default scenes/<name>/export/usd.")]
Times = Annotated[int | None, times_option("Number of time samples; by default one for each time, at most 60.")]


@of_last_run("coarse")
def usd(
    options: Options, out: Out = None, times: Times = None, time: Moment = None, up: Up = None, antialiased: Antialiased = False
) -> None:
    """One USD file with time samples (ParticleField3DGaussianSplat), for film and effects; convexes become Gaussians."""
    check_moment(time, times)
    axis, single = up_axis(up), is_file(out, ENDINGS)
    trained = open_trained(options)
    folder = trained.session.export_folder(out, "usd")
    path = folder if single else folder / f"{trained.session.scene.name}.usdc"

    from ...stages.exports.usd import export_usd

    moments = trained.chosen(times, time)
    console = Console()
    with Progress(2 * len(moments), "export", console) as bar, writing(path):
        done = export_usd(trained.model, trained.frames, path, moments, trained.times, axis, antialiased, bar.advance)
    count = f"{len(moments)} times" if len(moments) > 1 else "one time"
    said = f"{counted(done.gaussians, 'Gaussian')} at {count}, {done.rate:.6g} time codes a second; {done.loss}"
    say(said, *trained.thinned(len(moments), times), axes_line(done.turn, trained.frames), f"usd: {path}")
