"""Runs a plan: executes the stages one after another, then publishes their results."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console

from ..pipeline import Row, Runner, duration
from .last_run import remember
from .reconstruction import EVALUATION, LIBRARIES
from .results import completed
from .session import Session
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
