"""The command line of `e4dgs bench raster | field | cuda | step | pipeline`. Nothing heavy is imported before a row is measured."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer

from ...pipeline import say
from ..machine.places import typed_path
from ..machine.terminal import make_console
from ..options import Captures, Debug, of_captures, seen_as
from ..session import Options
from .ablation import ablation
from .pipeline import LADDER, check_plot, draw, measured, parse_points, summaries, table
from .rows import Bench
from .run import run
from .suites import REPEATS, SECONDS, SUITES

app = typer.Typer(no_args_is_help=True, help="Is this machine as fast as it should be? Times e4dgs against fixed bars and against itself.")

Rows = Annotated[str | None, typer.Option("--rows", metavar="NAME,NAME", help="Only these rows; see --list.")]
List = Annotated[bool, typer.Option("--list", help="List the rows and measure nothing.")]
Out = Annotated[
    Path | None, typer.Option("--out", parser=typed_path, metavar="FILE.json", help="Write every number, with machine and protocol.")
]
Threads = Annotated[int, typer.Option("--threads", min=0, help="0 takes all cores.")]
Repeats = Annotated[int, typer.Option("--repeats", min=1, help="Runs of each contender.")]
Seconds = Annotated[float, typer.Option("--seconds", min=0, help="Longest time for all runs of one contender.")]
Scale = Annotated[
    float, typer.Option("--scale", min=1e-4, max=1, help="Fraction of the full sizes, for a quick look; bars apply only at 1.")
]
Garden = Annotated[
    Path | None,
    typer.Option("--garden", parser=typed_path, metavar="FILE.npz", help="gsplat's test_garden.npz; by default a synthetic scene."),
]
Capture = Annotated[
    Path | None, typer.Option("--capture", parser=typed_path, metavar="CAPTURE", help="A capture with poses; by default the sample.")
]


def _measures(suite: str, *files: str) -> Callable[[Callable[[], None]], Callable[..., None]]:
    """A command that measures the rows of ``suite``. files: those of `Bench` that it takes."""
    of_files = {"garden": Garden, "capture": Capture}
    before: list[tuple[str, Any, Any]] = [("rows", Rows, None), ("list", List, False), *((name, of_files[name], None) for name in files)]
    after = [("out", Out, None), ("threads", Threads, 0), ("repeats", Repeats, REPEATS[suite]), ("seconds", Seconds, SECONDS[suite])]

    def measure(rows: str | None, list: bool, out: Path | None, threads: int, debug: bool, **given: Any) -> None:
        run(suite, SUITES[suite], Bench(**given), names=rows, only_list=list, threads=threads, out=out, console=make_console())

    return lambda command: seen_as(measure, command, [*before, *after, ("scale", Scale, 1.0), ("debug", Debug, False)])


@app.command()
@_measures("raster", "garden")
def raster() -> None:
    """The rasterizer: images of Gaussians and of convexes, without and with gradients."""


@app.command()
@_measures("field")
def field() -> None:
    """The deformation field, the image loss and the optimiser."""


@app.command()
@_measures("cuda", "garden", "capture")
def cuda() -> None:
    """The CUDA kernels on the first GPU: do they agree with the CPU's, how fast are they, what do they do when memory ends."""


@app.command()
@_measures("step", "capture")
def step() -> None:
    """The whole training step, and where its time goes."""


app.command()(ablation)


@app.command()
@of_captures("preset", "seed", "store_also")
def pipeline(
    captures: Captures,
    points: Annotated[str, typer.Option("--points", help="Presets or settings joined by +, separated by commas.")] = LADDER,
    seeds: Annotated[int, typer.Option("--seeds", min=1, help="Runs of each point, with seeds 0, 1, ...")] = 1,
    out: Out = None,
    plot: Annotated[
        Path | None, typer.Option("--plot", parser=typed_path, metavar="FILE.svg", help="Draw the curves: .svg or .png.")
    ] = None,
    *,
    options: Options,
) -> None:
    """Quality against run time of whole runs on captures; presets are points of the curve. Results are kept and reused in the workspace."""
    check_plot(plot)
    console = make_console()
    *_, runs = measured(captures, parse_points(points), seeds, options, out, console)
    console.print(table(summaries(runs)))
    if plot is not None:
        draw(plot, summaries(runs))
        say(f"plot: {plot}", to=console)
    if out is not None:
        say(f"numbers: {out}", to=console)
