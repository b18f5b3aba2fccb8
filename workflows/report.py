"""`e4dgs report`: draws the page of a finished run again, from the store alone."""

from __future__ import annotations

from rich.console import Console

from ..pipeline import make_plan, say
from .machine.writable import writing_to
from .options import of_last_run
from .reconstruction import EVALUATION
from .results import missing
from .runs import execute
from .session import Options, open_session


@of_last_run("evaluate")
def report(options: Options) -> None:
    """Write metrics.json and report.html of a finished run again, and say where they are."""
    session = open_session(options)
    rows = make_plan(session.job)
    (last,) = [row for row in rows if row.stage == EVALUATION]
    if last.state == "run":
        raise missing(session, last)
    console = Console()
    with writing_to(options.workspace.resolve()):
        (session.scene.folder / "records" / "report-shows.json").unlink(missing_ok=True)
        found = execute(session, rows, console, lambda line: None)
    assert found is not None
    say(str(found[1]))
