"""`e4dgs bench raster | field | cuda | step | pipeline`: the command line. Nothing heavy is imported before a row is measured."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from ...pipeline import Progress, SettingsError
from ..options import Captures, Debug, Device, Format, Set, Static, Workspace
from ..session import DEFAULT_WORKSPACE, Options
from . import output
from .pipeline import LADDER
from .rows import Bench, choose
from .suites import SUITES

WIDTH = 180  # of tables in a file or a pipe

app = typer.Typer(no_args_is_help=True, help="Run time against error on this machine, everything side by side in one run.")

Rows = Annotated[str | None, typer.Option("--rows", metavar="NAME,NAME", help="Only these rows; see --list.")]
List = Annotated[bool, typer.Option("--list", help="Name the rows and measure nothing.")]
Out = Annotated[Path | None, typer.Option("--out", metavar="FILE.json", help="Write every number, with machine and protocol.")]
Plot = Annotated[Path | None, typer.Option("--plot", metavar="FILE.svg", help="Draw the curves: .svg or .png; a name is added for each.")]
Threads = Annotated[int, typer.Option("--threads", min=0, help="0 takes all cores.")]
Repeats = Annotated[int, typer.Option("--repeats", min=1, help="Runs of each contender.")]
Seconds = Annotated[float, typer.Option("--seconds", min=0, help="Most time for the runs of one contender together.")]
Scale = Annotated[float, typer.Option("--scale", min=1e-4, max=1, help="Fraction of all sizes, for a quick look; bars hold at 1 only.")]


@app.command()
def raster(
    rows: Rows = None,
    list: List = False,
    garden: Annotated[
        Path | None, typer.Option("--garden", metavar="FILE.npz", help="gsplat's test_garden.npz; a synthetic scene without it.")
    ] = None,
    out: Out = None,
    plot: Plot = None,
    threads: Threads = 0,
    repeats: Repeats = 7,
    seconds: Seconds = 20.0,
    scale: Scale = 1.0,
    debug: Debug = False,
) -> None:
    """The rasterizer: against the pure blend limit, plain torch and itself; memory, determinism, accuracy, scaling, knobs."""
    if garden is not None and not garden.is_file():
        raise SettingsError(f"--garden {garden}: there is no such file")
    _run("raster", rows, list, Bench(scale, repeats, seconds, garden=garden), threads, out, plot)


@app.command()
def field(
    rows: Rows = None,
    list: List = False,
    out: Out = None,
    plot: Plot = None,
    threads: Threads = 0,
    repeats: Repeats = 15,
    seconds: Seconds = 20.0,
    scale: Scale = 1.0,
    debug: Debug = False,
) -> None:
    """The deformation field, the image loss and the optimiser, against torch."""
    _run("field", rows, list, Bench(scale, repeats, seconds), threads, out, plot)


@app.command()
def cuda(
    rows: Rows = None,
    list: List = False,
    garden: Annotated[
        Path | None, typer.Option("--garden", metavar="FILE.npz", help="gsplat's test_garden.npz; a synthetic scene without it.")
    ] = None,
    capture: Annotated[Path | None, typer.Option("--capture", metavar="CAPTURE", help="For the step; the sample without it.")] = None,
    out: Out = None,
    plot: Plot = None,
    threads: Threads = 0,
    repeats: Repeats = 15,
    seconds: Seconds = 20.0,
    scale: Scale = 1.0,
    debug: Debug = False,
) -> None:
    """The CUDA kernels on the first GPU: against the CPU's, gsplat and themselves."""
    if garden is not None and not garden.is_file():
        raise SettingsError(f"--garden {garden}: there is no such file")
    _run("cuda", rows, list, Bench(scale, repeats, seconds, garden=garden, capture=capture), threads, out, plot)


@app.command()
def step(
    rows: Rows = None,
    list: List = False,
    capture: Annotated[
        Path | None, typer.Option("--capture", metavar="CAPTURE", help="A capture with poses; a synthetic one without it.")
    ] = None,
    out: Out = None,
    plot: Plot = None,
    threads: Threads = 0,
    repeats: Repeats = 15,
    seconds: Seconds = 40.0,
    scale: Scale = 1.0,
    debug: Debug = False,
) -> None:
    """The whole training step, against the same step composed of torch operations, and where its time goes."""
    _run("step", rows, list, Bench(scale, repeats, seconds, capture=capture), threads, out, plot)


@app.command()
def pipeline(
    captures: Captures,
    points: Annotated[str, typer.Option("--points", help="By commas: presets, or settings joined by +.")] = LADDER,
    seeds: Annotated[int, typer.Option("--seeds", min=1, help="Runs of each point, with seeds 0, 1, ...")] = 1,
    workspace: Workspace = DEFAULT_WORKSPACE,
    set: Set = None,
    device: Device = "auto",
    static: Static = False,
    format: Format = None,
    out: Out = None,
    plot: Plot = None,
    debug: Debug = False,
) -> None:
    """Quality against run time of whole runs on captures; presets are points of the curve. Results are kept and reused in the workspace."""
    _check_plot(plot)
    from .machine import machine
    from .pipeline import content, draw, measure, parse_points, summaries, table

    console = _console()
    chosen = parse_points(points)
    every = [Options(capture, workspace, "default", set or (), device, None, static, format) for capture in captures]
    runs = []
    for number, (options, point, seed) in enumerate((o, p, s) for o in every for p in chosen for s in range(seeds)):
        console.print(
            f"[{number + 1}/{len(every) * len(chosen) * seeds}] {options.capture.name}: {point[0]}, seed {seed}",
            highlight=False,
            markup=False,
        )
        runs.append(measure(options, point, seed, console, lambda line: console.print("  " + line, markup=False, highlight=False)))
        if out is not None:  # after each run: hours of others are not lost with one
            output.write(out, content(runs, machine(), every[0]))
    console.print(table(summaries(runs)))
    if plot is not None:
        draw(plot, summaries(runs))
        console.print(f"plot: {plot}", markup=False, highlight=False, soft_wrap=True)
    if out is not None:
        console.print(f"numbers: {out}", markup=False, highlight=False, soft_wrap=True)


def _console() -> Console:
    console = Console()
    return console if console.is_terminal else Console(width=WIDTH)


def _check_plot(plot: Path | None) -> None:
    if plot is not None and plot.suffix not in (".svg", ".png"):
        raise SettingsError(f"--plot {plot}: the file must end in .svg or .png")


def _run(suite: str, names: str | None, only_list: bool, bench: Bench, threads: int, out: Path | None, plot: Path | None) -> None:
    """Measure the chosen rows one after another; every row is written as soon as it is measured."""
    console = _console()
    _check_plot(plot)
    if only_list:
        output.show_rows(console, SUITES[suite])
        return
    rows = choose(SUITES[suite], names)

    import torch

    from .machine import kernels, machine

    before = torch.get_num_threads()
    torch.set_num_threads(threads or before)
    try:
        facts = machine() | kernels()
        measured = {}
        if bench.scale != 1:
            console.print(f"sizes are {bench.scale:g} of the full ones: bars are shown, but nothing is judged", highlight=False)
        for row in rows:
            with Progress(0, row.name, console) as bench.progress:
                found = row.measure(bench)
            output.show_row(console, row, found, bench.scale == 1)
            measured[row.name] = output.row_json(row, found)
            if out is not None:
                output.write(out, output.report(suite, bench, facts, measured))
    finally:
        torch.set_num_threads(before)
    if plot is not None:
        from .plots import draw

        for path in draw(plot, measured):
            console.print(f"plot: {path}", markup=False, highlight=False, soft_wrap=True)
    if out is not None:
        console.print(f"numbers: {out}", markup=False, highlight=False, soft_wrap=True)
