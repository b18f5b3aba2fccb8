"""`e4dgs batch` and `e4dgs status`."""

from __future__ import annotations

import shlex
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated, Any, Literal

import typer
from rich.console import Console

from ...pipeline import SettingsError, counted, say
from ...stages.captures import usual
from ..machine.terminal import make_console
from ..machine.writable import writing_to
from ..options import Debug, Workspace, of_captures, typed_name
from ..results import words_of
from ..scenes import check_name
from ..session import DEFAULT_WORKSPACE, Options, assigned, other_stores
from .board import table, watch
from .ledger import Ledger, SceneState, batches
from .listing import Entry, entries_of
from .local import Local, usual_jobs
from .share import usual_memory_gb
from .sites.cluster import Parsl, read_cluster
from .sites.pools import Cluster
from .sites.slurm import USUAL, USUAL_GPU
from .sites.slurm import emit as write_scripts
from .summary import rows_of, write_summary
from .work import is_current

MOST_NAMES = 5  # of a replaced batch that are printed
MOST_COMMANDS = 10  # printed at the end; the table has all of them
# What replaces options that apply only to this machine: in a cluster's file, and in job scripts.
INSTEAD = {
    "--jobs": ("set workers and nodes of its pools", "Slurm starts as many as fit"),
    "--memory": ("set memory_gb of its pools", "set memory_gb of the pools in a file for --executor"),
    "--retries": ("set retries", "a job tries once, and the same command submits unfinished scenes again"),
}


@of_captures()
def batch(
    captures: Annotated[list[str], typer.Argument(metavar="CAPTURE...", help="Paths, patterns with *, lists of scenes in YAML.")],
    name: Annotated[str, typer.Option("--name", callback=typed_name, help="Name of the batch; the same name continues it.")] = "batch",
    executor: Annotated[
        str, typer.Option("--executor", metavar="local|FILE.yaml", help="This machine, or the file of a cluster.")
    ] = "local",
    jobs: Annotated[int | None, typer.Option("--jobs", min=1, max=1024, help="local: scenes that run at the same time.")] = None,
    memory: Annotated[float | None, typer.Option("--memory", min=0.001, help="local: GB for all stages together; 90 % by default.")] = None,
    retries: Annotated[
        int | None, typer.Option("--retries", min=0, max=100, help="local: how often to retry a failed scene; 1 by default.")
    ] = None,
    stage_timeout: Annotated[float | None, typer.Option("--stage-timeout", min=0.1, help="Seconds after which a stage is stopped.")] = None,
    emit: Annotated[Literal["slurm"] | None, typer.Option("--emit", help="Write job scripts and run nothing.")] = None,
    *,
    options: Options,
) -> None:
    """Run many captures; an unfinished batch is continued. Exit code 1 if a scene failed."""
    check_name(name, f"--name {name}")
    choice, workspace = options.choice, options.workspace.resolve()
    settings, device = assigned(choice.set), choice.device
    _refuse_what_is_local({"--jobs": jobs, "--memory": memory, "--retries": retries}, executor, emit)
    cluster = None
    if executor != "local":
        cluster = read_cluster(Path(executor))
        for pool in ("cpu", "gpu") if emit is not None else ():
            if (provider := getattr(getattr(cluster, pool), "provider", emit)) != emit:
                raise SettingsError(
                    f"--emit {emit}: {executor}: {pool}: provider is {provider}; a pool for job scripts has provider: {emit}"
                )
    # Pictures are prepared on nodes without a GPU, and have the size that is usual where they are trained on.
    gpu = device != "cpu" and (emit is not None if cluster is None else cluster.gpu is not None)
    sized = (("frames.max_size", str(usual.USUAL["cuda"].size)),) if gpu else ()
    also = tuple(str(path) for path in other_stores(options.store_also))
    common = Entry("", "", (*sized, *settings), choice.preset, choice.static, choice.format, device, store_also=also)
    entries = entries_of(captures, common)
    words = ["e4dgs", "batch", *captures, *words_of_batch(name, executor, jobs, memory, retries, stage_timeout, emit)]
    words += words_of(options)[1:]
    with ExitStack() as held:
        with writing_to(workspace):
            held.enter_context(Ledger(workspace, name).held(entries))
            if before := Ledger(workspace, name).replaced_by(entries):
                shown = ", ".join(before[:MOST_NAMES]) + (", ..." if len(before) > MOST_NAMES else "")
                say(
                    f"--name {name}: this replaces the earlier batch of {counted(len(before), 'scene')} ({shown}), "
                    "whose results stay in the workspace; another --name keeps both"
                )
            ledger = Ledger.create(workspace, name, entries, shlex.join(words))
        for entry in entries:
            if ledger.progress(entry.name).state == "done" and not is_current(ledger, entry):
                ledger.write(entry.name, SceneState())
        if emit is not None:
            _write_scripts(ledger, cluster, device, stage_timeout)
            return
        runner: Any
        if cluster is None:
            tries = 1 if retries is None else retries
            runner = Local(ledger, min(jobs or usual_jobs(), len(entries)), memory or usual_memory_gb(), tries, stage_timeout)
        else:
            runner = Parsl(ledger, cluster, stage_timeout)
        _run(ledger, runner)


def _write_scripts(ledger: Ledger, cluster: Cluster | None, device: str, stage_timeout: float | None) -> None:
    """Writes job scripts for Slurm, and says how to submit them."""
    cluster = cluster or Cluster.model_validate({"cpu": USUAL, "gpu": None if device == "cpu" else USUAL_GPU})
    say(f"submit with: {write_scripts(ledger, cluster, stage_timeout)}/submit.sh")


def _run(ledger: Ledger, runner: Any) -> None:
    """Runs what is not done and shows it. Raises Exit with code 1 if a scene failed."""
    entries = ledger.entries()
    try:
        futures = runner.start([entry for entry in entries if ledger.progress(entry.name).state != "done"])
        watch(ledger, Console(), lambda: all(future.done() for future in futures))
    finally:
        runner.stop()
        page = write_summary(ledger)
    failed = [row for row in rows_of(ledger) if row["state"] != "done"]
    say(*(f"run {row['scene']} again: {row['command']}" for row in failed[:MOST_COMMANDS]))
    say(f"{len(entries) - len(failed)} of {len(entries)} scenes are done: {page}")
    if failed:
        raise typer.Exit(1)


def words_of_batch(
    name: str, executor: str, jobs: int | None, memory: float | None, retries: int | None, stage_timeout: float | None, emit: str | None
) -> list[str]:
    """The options that only `batch` has, as words of a command line, without those that have their default."""
    given = (
        *(("--name", name, "batch"), ("--executor", executor, "local"), ("--jobs", jobs, None), ("--memory", memory, None)),
        *(("--retries", retries, None), ("--stage-timeout", stage_timeout, None), ("--emit", emit, None)),
    )
    return [word for flag, value, default in given if value != default for word in (flag, str(value))]


def status(
    name: Annotated[
        str | None, typer.Argument(metavar="NAME", callback=typed_name, help="Name of a batch; the newest one by default.")
    ] = None,
    workspace: Workspace = DEFAULT_WORKSPACE,
    debug: Debug = False,
) -> None:
    """Show a running or finished batch, from its files alone."""
    known = batches(workspace.resolve())
    if name is None and not known:
        raise SettingsError(f"{workspace}: no batch has been run in this workspace")
    ledger = Ledger(workspace.resolve(), name or known[-1])
    ledger.entries()
    make_console().print(table(ledger))


def _refuse_what_is_local(given: dict[str, Any], executor: str, emit: str | None) -> None:
    """Refuses options of `local.Local` where they would have no effect."""
    if executor == "local" and emit is None:
        return
    for option, value in given.items():
        if value is None:
            continue
        in_file, in_scripts = INSTEAD[option]
        if emit is not None:
            raise SettingsError(f"{option} is for batches that run on this machine, not for --emit {emit}: {in_scripts}")
        raise SettingsError(f"{option} is for batches on this machine, not for --executor {executor}: {in_file} in that file")
