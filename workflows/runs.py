"""Runs a plan: executes the stages one after another, then publishes their results. `e4dgs report` publishes them again."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console

from ..pipeline import Artifact, Outcome, Row, Runner, duration, make_plan, say
from .last_run import remember
from .machine.terminal import make_console
from .machine.writable import writing_to
from .options import of_last_run
from .reconstruction import EVALUATION, LIBRARIES
from .results import completed, made, missing
from .session import Options, Session, open_session
from .timing.known import Known
from .timing.left import Left
from .timing.timed import Timed


def execute(
    session: Session,
    rows: Sequence[Row],
    console: Console,
    say: Callable[[str], None],
    targets: Sequence[str] | None = None,
    forced: Sequence[str] = (),
    timed: Timed | None = None,
) -> tuple[Mapping[str, Any], Path] | None:
    """Runs ``targets`` (None: all stages) and what they need. Returns the metrics and the path of the report, or None if none was made.
    timed: decides settings on the way, for a run that keeps to a time. Raises what `Runner.run` and `Scene.claim` raise."""
    from .. import __version__
    from .publish import publish, write_plan

    target, began, told = "all" if targets is None else targets[0], time.time(), False
    left = Left(rows)
    known = Known(session.job.store.root.parent, session.job.device)

    def finished(outcome) -> None:
        nonlocal told
        session.scene.restore()
        if outcome.state == "ran":
            used = f"done in {duration(outcome.seconds)}, at most {outcome.peak_rss_mb:.0f} MB"
            say(f"{outcome.stage}: {used}{left.after(outcome)}")
            if timed is None:
                known.learn_stage(session.job, outcome)
                known.write()
        decided = timed is not None and timed.finished(outcome)
        if decided or not told:  # as soon as there is something to look at
            remember(session, target, began)
            told = True
        write_plan(session, rows)

    name = session.scene.name
    session.claim()  # before anything is written, so that no other capture of that name starts in the same folder
    if session.scene.name != name:
        say(f"another capture has just taken the name {name}, so the scene is called {session.scene.name} (see --name)")
    try:
        outcomes = Runner(session.job, lambda line: say(completed(line, session.options)), console, __version__, LIBRARIES).run(
            targets, forced, finished
        )
    except BaseException:
        session.scene.release()  # a capture that the first stage refuses leaves no scene behind
        raise
    remember(session, target, began, done=True)
    if outcomes[-1].stage != EVALUATION or outcomes[-1].artifact is None:
        return None
    begin = time.monotonic()
    published = publish(session, rows, outcomes)
    if timed is not None:
        timed.published(time.monotonic() - begin)
    return published


@of_last_run("evaluate")
def report(options: Options) -> None:
    """Write metrics.json and report.html of a finished run again, and say where they are."""
    session = open_session(options)
    rows = make_plan(session.job)
    (last,) = [row for row in rows if row.stage == EVALUATION]
    if last.state == "run":
        say(str(_page_of_last_run(session, rows, last)))
        return
    console = make_console()
    with writing_to(options.workspace.resolve()):
        (session.scene.folder / "records" / "report-shows.json").unlink(missing_ok=True)
        found = execute(session, rows, console, lambda line: None)
    assert found is not None
    say(str(found[1]))


def _page_of_last_run(session: Session, rows: Sequence[Row], last: Row) -> Path:
    """Draws the page of what the scene's last run made, also if the code or the capture has changed since. Raises NoRunError if the store
    no longer has it, or other options were given."""
    from .publish import publish

    found = made(session, EVALUATION) if session.options.last else None
    if found is None:
        raise missing(session, last)
    outcomes = [_outcome(row, found.get(row.stage)) for row in rows]
    with writing_to(session.options.workspace.resolve()):
        session.claim()
        (session.scene.folder / "records" / "report-shows.json").unlink(missing_ok=True)
        return publish(session, rows, outcomes)[1]


def _outcome(row: Row, artifact: Artifact | None) -> Outcome:
    if artifact is None:
        return Outcome(row.stage, "skipped", row.reason if row.state == "skip" else "the last run did not use it")
    spent = artifact.provenance
    return Outcome(row.stage, "cached", "of the last run", spent["seconds"], spent["peak_rss_mb"], artifact)
