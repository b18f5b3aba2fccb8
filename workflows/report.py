"""`e4dgs report`: draws the page of a finished run again, from the store alone."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from ..pipeline import Artifact, Outcome, Row, make_plan, say
from .machine.terminal import make_console
from .machine.writable import writing_to
from .options import of_last_run
from .reconstruction import EVALUATION
from .results import made, missing
from .runs import execute
from .session import Options, Session, open_session


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
