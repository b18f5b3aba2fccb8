"""The command line. Exit codes: 0 done, 1 a stage failed, 2 bad arguments or a bad capture, 130 interrupted."""

from __future__ import annotations

import functools
import json
import os
import sys
import traceback
from collections.abc import Callable
from contextlib import nullcontext
from typing import Annotated, Any

import typer
from rich.console import Console

from ..pipeline import PipelineError, check_targets, explain, make_plan, say
from . import show
from .batch.command import batch, status
from .bench.ablation import ablation
from .bench.cli import app as bench
from .exports.command import app as export
from .exports.render import render
from .machine.interrupts import end_cleanly_when_terminated, ended, said_when_interrupted
from .machine.orphan import end_with_starter
from .machine.spinning import spin_briefly
from .machine.terminal import make_console, write_any_letter
from .machine.writable import writing_to
from .options import Debug, Workspace, of_capture, of_last_run
from .runs import execute, report
from .session import DEFAULT_WORKSPACE, Options, open_session
from .storage.command import COMMANDS
from .storage.command import app as store
from .timing.begin import begin, expect
from .view.beside import viewer_beside
from .view.command import view

app = typer.Typer(
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    help="Turns captures of moving scenes into 4D models that render any view at any time.",
)
app.add_typer(bench, name="bench")
app.add_typer(export, name="export")
app.command()(batch)
app.command()(status)
app.command()(view)
app.command()(render)
app.command()(report)
app.add_typer(store, name="store")
console = make_console()
INTERRUPTED = 130  # the convention of shells and of the command-line parser


def _keep(old: str, new: str, command: Callable[..., Any]) -> None:
    """Keeps an older spelling of a command, which is not listed and names the new one."""

    @functools.wraps(command)
    def run(**given: Any) -> Any:
        print(f"e4dgs {old} is called e4dgs {new} now", file=sys.stderr)
        return command(**given)

    app.command(old, hidden=True)(run)


for moved, command in COMMANDS.items():
    _keep(moved, f"store {moved}", command)
_keep("ablation", "bench ablation", ablation)


def _version(wanted: bool) -> None:
    if wanted:
        from .. import __version__

        print(f"e4dgs {__version__}")
        raise typer.Exit


@app.callback()
def options_of_all(
    version: Annotated[bool, typer.Option("--version", callback=_version, is_eager=True, help="Show the version and exit.")] = False,
) -> None:
    pass


ONE_STAGE = "All stages, or one and what it needs: frames, poses, depth, flow, seeds, coarse, hulls, fine, evaluate."


@app.command()
@of_capture
def run(
    target: Annotated[str, typer.Argument(metavar="all|STAGE", help=ONE_STAGE)],
    options: Options,
    force: Annotated[bool, typer.Option("--force", help="Run the stage (with 'all': every stage) even if it is cached.")] = False,
    watch: Annotated[bool, typer.Option("--view", help="Open the viewer as soon as there is something to see.")] = False,
) -> None:
    """Run stages; what is in the store is reused."""
    session, timed = begin(options, say, anew=force and target == "all")
    targets = check_targets(session.job.graph.stages, target)
    forced = tuple(targets or session.job.graph.stages) if force else ()
    rows = expect(session, make_plan(session.job, targets, forced))
    show.show_capture(console, session)
    show.show_plan(console, rows, session)
    told = {f"  frames: {note}" for note in session.notes}  # above; they stay in the log of the result

    def tell(line: str) -> None:
        if line not in told:
            say(line)

    with viewer_beside(options) if watch else nullcontext(), writing_to(options.workspace.resolve()):
        if (found := execute(session, rows, console, tell, targets, forced, timed)) is not None:
            show.show_metrics(console, *found)
        if watch:
            say("the viewer keeps running; Ctrl-C stops it")


@app.command()
@of_capture
def plan(options: Options, as_json: Annotated[bool, typer.Option("--json", help="The plan as JSON.")] = False) -> None:
    """Show what a run would do, stage by stage, and why. Nothing runs, and no result is written."""
    from .publish import plan_json

    session, _ = begin(options, say if not as_json else lambda line: None)
    rows = expect(session, make_plan(session.job))
    if as_json:
        print(json.dumps(plan_json(session, rows), indent=2, ensure_ascii=False))
        return
    show.show_capture(console, session)
    show.show_plan(console, rows, session)


@app.command()
@of_last_run("frames", done=False)
def why(stage: Annotated[str, typer.Argument(metavar="STAGE")], options: Options) -> None:
    """Say which setting, input or source file changed since a stage last ran for this capture."""
    session = open_session(options)
    say(*explain(session.job, stage))


@app.command()
def doctor(
    workspace: Workspace = DEFAULT_WORKSPACE,
    licenses: Annotated[bool, typer.Option("--licenses", help="Instead, the licences of e4dgs, its packages and weights.")] = False,
    debug: Debug = False,
) -> None:
    """Check this installation; exit code 1 when something that is needed does not work."""
    from .machine.doctor import checks
    from .machine.licences import licences

    for one in licences() if licenses else ():
        note = f"  ({one.note})" if one.note else ""
        say(f"{f'{one.name} {one.version}':42} {one.terms}{note}")
    if licenses:
        return
    broken = 0
    for what, well, detail in checks(workspace):
        broken += well is False
        mark = {True: "[green]ok[/]  ", False: "[red]FAIL[/]", None: "    "}[well]
        console.print(f"{mark} {what}: ", end="", highlight=False)
        say(detail)
    if broken:
        raise typer.Exit(1)


def main(arguments: list[str] | None = None) -> Any:
    """Console script: runs a command and returns its exit code."""
    write_any_letter()
    arguments = sys.argv[1:] if arguments is None else arguments
    errors = Console(stderr=True)
    spin_briefly()
    end_cleanly_when_terminated()
    end_with_starter()
    try:
        code = app(arguments, prog_name="e4dgs", standalone_mode=False) or 0
    except (KeyboardInterrupt, typer.Abort):
        code = INTERRUPTED
    except Exception as error:
        if hasattr(error, "format_message") and hasattr(error, "exit_code"):  # a usage error of the command line's parser
            context = getattr(error, "ctx", None)
            help_hint = f" (see {context.command_path} --help)" if context is not None else ""
            told = error.format_message()
            if "unexpected extra argument" in told and sum(map(os.path.exists, arguments)) > 1:
                told += (
                    ". A capture is one file or folder: put videos of one event into a folder and pass it, or use e4dgs batch for scenes"
                )
            if told:  # empty when no argument was given: the help is already printed
                say(f"error: {told}{help_hint}", to=errors)
            return 2
        if "--debug" in arguments:
            traceback.print_exc()
        message = str(error) if isinstance(error, PipelineError) else f"{type(error).__name__}: {error} (--debug shows where)"
        say(f"error: {message}", to=errors)
        return error.exit_code if isinstance(error, PipelineError) else 1
    finally:
        ended()
    if code == INTERRUPTED:
        errors.print(said_when_interrupted(arguments), highlight=False)
    return code


if __name__ == "__main__":
    sys.exit(main())
