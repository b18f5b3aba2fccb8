"""The options that are common to all commands about a capture, each defined and explained once, and how a command receives them.

A command that is decorated with `of_capture`, `of_captures` or `of_last_run` takes one parameter ``options: Options`` in place of them all.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer

from ..pipeline import PipelineError
from ..pipeline.names import composed
from .last_run import decided_for
from .machine.places import check_output, check_workspace, typed_path
from .results import completed
from .session import DEFAULT_WORKSPACE, NO_CHOICE, SEEDS, Choice, Options
from .timing.words import seconds_of, words_for
from .which_scene import Given, options_of_last_run, scene_or_capture


def typed_name(value: str | None) -> str | None:
    """The value of --name, in the form that names of scenes and batches have: terminals and file managers differ in that of accents."""
    return value and composed(value)


Capture = Annotated[
    Path, typer.Argument(parser=typed_path, metavar="CAPTURE", help="A video, a folder of images, a folder with poses, or a scene.")
]
Scene = Annotated[
    Path | None,
    typer.Argument(
        parser=typed_path,
        metavar="CAPTURE|SCENE",
        help="A capture, or a scene: its folder or its name. By default the scene that ran last.",
    ),
]
Captures = Annotated[list[Path], typer.Argument(parser=typed_path, metavar="CAPTURE...", help="Captures, as `run` takes them.")]
Workspace = Annotated[Path, typer.Option("--workspace", parser=typed_path, metavar="DIR", help="Folder that holds store/ and scenes/.")]
Preset = Annotated[str, typer.Option("--preset", help="Named set of settings: default, fast, compact, best.")]
PresetOfRun = Annotated[str | None, typer.Option("--preset", help="Preset of the run; by default that of the last one.")]
Set = Annotated[
    list[str] | None,
    typer.Option(
        "--set", metavar="STAGE.KEY=VALUE", help="A setting of a stage, such as frames.max_size=640 (docs/settings.md); may be repeated."
    ),
]
Device = Annotated[str, typer.Option("--device", help="auto, cpu or cuda.")]
Name = Annotated[str | None, typer.Option("--name", callback=typed_name, help="Name of the scene; the capture's own name by default.")]
Static = Annotated[bool, typer.Option("--static", help="Nothing moves in this capture.")]
Format = Annotated[
    str | None, typer.Option("--format", help="Format of the capture, if its files fit several: see frames.format in docs/settings.md.")
]
Time = Annotated[
    str | None,
    typer.Option("--time", metavar="TIME", help="The best result in this time on this machine: 90s, 10m, 1h30m. Decides steps and sizes."),
]
StoreAlso = Annotated[
    list[Path] | None,
    typer.Option(
        "--store-also",
        parser=typed_path,
        metavar="DIR",
        help="Another workspace, which is only read: its results are reused; may be repeated.",
    ),
]
Seed = Annotated[int | None, typer.Option("--seed", min=0, max=2**31 - 1, help="Seed of everything that is drawn at random; 0 by default.")]
Debug = Annotated[bool, typer.Option("--debug", help="Show a traceback with an error.")]

OUTPUTS = ("out", "plot")  # options of the commands that name what they write
_REQUIRED = inspect.Parameter.empty
_OF_RUN: Mapping[str, tuple[Any, Any]] = {  # name -> annotation, default
    "workspace": (Workspace, DEFAULT_WORKSPACE),
    "preset": (Preset, "default"),
    "set": (Set, None),
    "seed": (Seed, None),
    "device": (Device, "auto"),
    "name": (Name, None),
    "static": (Static, False),
    "format": (Format, None),
    "time": (Time, None),
    "store_also": (StoreAlso, None),
    "debug": (Debug, False),  # read by `cli.main`
}
_OF_SEVERAL = {name: row for name, row in _OF_RUN.items() if name not in ("name", "time")}  # several runs share a machine
_OF_LAST_RUN = {name: row for name, row in _OF_RUN.items() if name not in ("seed", "store_also")} | {"preset": (PresetOfRun, None)}


def of_capture(command: Callable[..., None]) -> Callable[..., None]:
    """Gives a command the options of a run of a capture, as ``options: Options``."""

    def gathered(capture: Path, workspace: Path, debug: bool, **given: Any) -> Options:
        path, name, workspace = scene_or_capture(capture, workspace, given.pop("name"))
        return with_decided(_options(path, workspace, name, **given))

    return _with_options(command, {"capture": (Capture, _REQUIRED)}, _OF_RUN, gathered)


def of_captures(*without: str) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Gives a command about several captures the options of their runs, except those that it calls ``without``, as ``options: Options``.
    Its capture is `Path()` and stands for each of them."""
    rows = {name: row for name, row in _OF_SEVERAL.items() if name not in without}

    def gathered(workspace: Path, debug: bool, **given: Any) -> Options:
        return _options(Path(), workspace, **given)

    return lambda command: _with_options(command, {}, rows, gathered)


def _options(
    capture: Path, workspace: Path, name: str | None = None, store_also: list[Path] | None = None, seed: int | None = None, **given: Any
) -> Options:
    seeds = [] if seed is None else [f"{setting}={seed}" for setting in SEEDS]
    return Options(capture, workspace, _choice(**{**given, "set": [*seeds, *(given.get("set") or ())]}), name, store_also or ())


def _choice(set: list[str] | None = None, **given: Any) -> Choice:
    return Choice(set=tuple(set or ()), **given)


def of_last_run(stage: str, done: bool = True) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Gives a command the options of an earlier run, as ``options: Options``: those that were given, or those of the last run of the
    capture that included ``stage``. done: prefer a run that came to its end."""

    def gathered(capture: Path | None, workspace: Path, name: str | None, preset: str | None, debug: bool, **given: Any) -> Options:
        choice = _choice(preset=preset or "default", **given)
        choose = preset is not None or replace(choice, device="auto") != NO_CHOICE
        return with_decided(options_of_last_run(Given(capture, workspace, choice, name, choose), stage, done))

    def given_them(command: Callable[..., None]) -> Callable[..., None]:
        own = inspect.signature(command).parameters  # --time has another meaning where something is rendered or exported
        return _with_options(command, {"capture": (Scene, None)}, {k: row for k, row in _OF_LAST_RUN.items() if k not in own}, gathered)

    return given_them


def with_decided(options: Options) -> Options:
    """``options`` with their time in its shortest words, and with the settings that an earlier run decided for it. Raises SettingsError."""
    if options.choice.time is not None:
        options.choice = replace(options.choice, time=words_for(seconds_of(options.choice.time)))
        run = decided_for(options)
        options.choice = replace(options.choice, resolved=() if run is None else run.choice.resolved)
    return options


def _with_options(
    command: Callable[..., None],
    argument: Mapping[str, tuple[Any, Any]],
    options: Mapping[str, tuple[Any, Any]],
    gathered: Callable[..., Options],
) -> Callable[..., None]:
    """``command`` with its parameter ``options`` replaced: by ``argument`` in its place, and by ``options`` after all other parameters."""

    def run(**given: Any) -> None:
        chosen = gathered(**{name: given.pop(name) for name in (*argument, *options)})
        check_workspace(chosen.workspace)
        for name in OUTPUTS:
            for capture in given.get("captures", (chosen.capture,)) if given.get(name) is not None else ():
                check_output(f"--{name}", given[name], capture.expanduser(), chosen.workspace)
        try:
            command(options=chosen, **given)
        except PipelineError as error:
            error.args = (completed(str(error), chosen),)
            raise

    own = inspect.signature(command, eval_str=True).parameters.values()
    described = [(one.name, one.annotation, one.default) for one in own]
    place = next(k for k, (name, _, _) in enumerate(described) if name == "options")
    described[place : place + 1] = [(name, *row) for name, row in argument.items()]
    described += [(name, *row) for name, row in options.items()]
    return seen_as(run, command, described)


def seen_as(run: Callable[..., None], command: Callable[..., None], parameters: Sequence[tuple[str, Any, Any]]) -> Callable[..., None]:
    """``run``, which takes keywords, as the command line sees it: called and explained as ``command`` is, with ``parameters``: name,
    annotation and default of each."""
    run.__name__, run.__doc__, run.__module__ = command.__name__, command.__doc__, command.__module__
    kind = inspect.Parameter.KEYWORD_ONLY
    run.__signature__ = inspect.Signature(  # type: ignore[attr-defined]
        [inspect.Parameter(name, kind, default=default, annotation=annotation) for name, annotation, default in parameters]
    )
    run.__annotations__ = {name: annotation for name, annotation, _ in parameters}
    return run
