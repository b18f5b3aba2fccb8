"""Results of a capture in the store, found by the options of the run that made them."""

from __future__ import annotations

import re
import shlex
from dataclasses import replace
from pathlib import Path

from ..pipeline import Artifact, CaptureError, Row, make_plan
from .last_run import last_run
from .scenes import scenes_of
from .session import DEFAULT_WORKSPACE, Options, Session
from .which_scene import NoRunError


def results(session: Session, stage: str) -> dict[str, Artifact | None]:
    """The stored results of ``stage`` and the stages it needs, by name; None for stages that this capture skips.

    If the last run is meant, these are the results that it made, also if the code or the capture has changed since. Raises CaptureError if
    ``stage`` itself is skipped, NoRunError if there is no such result; the message names the runs that exist.
    """
    rows = {row.stage: row for row in make_plan(session.job, [stage])}
    wanted, capture = rows[stage], session.options.capture
    if wanted.state == "skip":
        raise CaptureError(f"{capture}: this capture has no {stage}: {wanted.reason}")
    if wanted.state == "cached":
        return {name: row.artifact for name, row in rows.items()}
    if session.options.last and (found := made(session, stage)) is not None:
        return {name: found.get(name) for name in rows}
    raise missing(session, wanted)


def made(session: Session, stage: str) -> dict[str, Artifact | None] | None:
    """What the scene's last run of ``stage`` made, and the results that it was made from, by stage; None if the store no longer has it."""
    record, store = session.job.records.read(stage), session.job.store
    if record is None or not store.has(stage, record["key"]):
        return None
    found: dict[str, Artifact | None] = {stage: store.open(stage, record["key"])}
    waiting = list(record["parts"].get("inputs", {}).items())
    while waiting:
        name, digest = waiting.pop()
        if name in found:
            continue
        found[name] = None
        for _, key in (entry for entry in store.entries() if entry[0] == name):
            manifest = store.manifest(name, key)
            if digest is not None and manifest is not None and manifest["digest"] == digest:
                found[name] = store.open(name, key)
                waiting += manifest["provenance"].get("parts", {}).get("inputs", {}).items()
                break
    return found


def missing(session: Session, wanted: Row, target: str | None = None) -> NoRunError:
    """The error for a result that the store does not have. The message names the last run of this capture that made one, if there is any,
    and the command that makes it: a run of ``target``, by default of the stage itself."""
    options, stage = session.options, wanted.stage
    runs = [
        (scene.name, run) for scene in scenes_of(session.scene.capture, session.job.store.root.parent) if (run := last_run(scene, stage))
    ]
    if not runs or options.last:
        return NoRunError(
            f"{options.capture}: the workspace {options.workspace} has no {stage} of this capture ({wanted.reason}); "
            f"make it with: {run_command(options, target or stage)}{_moved(session)}"
        )
    name, run = max(runs, key=lambda found: found[1].began)
    return NoRunError(
        f"{options.capture}: the workspace {options.workspace} has no {stage} of this capture with these options ({wanted.reason}). "
        f"The last run, of the scene {name}, had {run.words}: give the same options, or none to take that run. "
        f"To make this one: {run_command(options, target or stage)}"
    )


def _moved(session: Session) -> str:
    """For a capture whose results may be those of a scene that was made before it was moved."""
    scene = session.scene
    if not scene.renamed or scene.gone is None:
        return ""
    return (
        f". The scene {scene.own_name} was made from {scene.gone}, which is not there any more; if this is that capture, moved, "
        f"add --name {scene.own_name}"
    )


def run_command(options: Options, stage: str) -> str:
    """The command that runs ``stage`` with the same options, ready to paste into a shell."""
    return shlex.join(["e4dgs", "run", stage, *words_of(options)])


def completed(text: str, options: Options) -> str:
    """``text`` for people, with the capture and the options of a run in each command that it tells them to type.

    Below this floor nobody knows them, so stages write "e4dgs run STAGE CAPTURE", "e4dgs export KIND CAPTURE" and "e4dgs store COMMAND".
    """

    def words(found: re.Match[str]) -> str:
        command, what = found.groups()
        if command == "run":
            return run_command(options, what)
        taken = replace(options, choice=replace(options.choice, time=None), store_also=())  # exports take neither
        return shlex.join(["e4dgs", "export", what, *words_of(taken)])

    if options.capture != Path():  # one capture
        text = re.sub(r"\be4dgs (run|export) (\w+) CAPTURE\b", words, text)
    return re.sub(r"\be4dgs store \w+\b(?! --workspace)", lambda found: found[0] + in_workspace(options.workspace), text)


def in_workspace(workspace: Path) -> str:
    """The option that names a workspace, to put behind a command; "" for the default."""
    default = workspace == DEFAULT_WORKSPACE or workspace == DEFAULT_WORKSPACE.resolve()
    return "" if default else f" --workspace {shlex.quote(str(workspace))}"


def words_of(options: Options) -> list[str]:
    """The capture and the options as words of a command line, without options that have their default."""
    capture = str(options.capture)
    words = [f"./{capture}" if capture.startswith("-") else capture]  # a word that begins with - is an option
    words += ["--workspace", str(options.workspace)] if str(options.workspace) != str(DEFAULT_WORKSPACE) else []
    words += ["--name", options.name] if options.name is not None else []
    return words + [word for path in options.store_also for word in ("--store-also", str(path))] + options.choice.words()


def trained_stage(session: Session) -> str:
    """The stage that makes the final model with these settings: `fine`, or `coarse` if `fine` is skipped. If the last run is meant and did
    not come as far as `fine`, it is `coarse` as soon as that is there."""
    (fine,) = [row for row in make_plan(session.job) if row.stage == "fine"]
    if fine.state == "skip":
        return "coarse"
    unfinished = session.options.last and fine.state == "run" and made(session, "fine") is None
    return "coarse" if unfinished and made(session, "coarse") is not None else "fine"
