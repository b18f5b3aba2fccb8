"""Opens the session of a run that may have to keep to a time, and says what each of its stages is expected to take."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from ...pipeline import Row
from ..last_run import decided_for, facts_of
from ..reconstruction import EVALUATION
from ..session import Options, Session, open_session
from .decisions import Decisions
from .defaults import COARSE, FINE, HULLS, guessed_times, steps_at_one
from .evaluating import Evaluating, choose_with
from .known import Known
from .ladder import STEPS
from .size import sized
from .timed import Timed, left_to_publish
from .words import Deadline, seconds_of


def begin(options: Options, say: Callable[[str], None], anew: bool = False) -> tuple[Session, Timed | None]:
    """The session of a run, and what decides its settings if it has to keep to a time. say: called with lines for people. anew: what an
    earlier run decided for the same time does not count. Raises what `open_session` raises."""
    if options.choice.time is None:
        return open_session(options), None
    deadline = Deadline(seconds_of(options.choice.time))
    if anew:
        options.choice = replace(options.choice, resolved=())
    session = open_session(options)
    if options.choice.resolved and (run := decided_for(options)) is not None and run.facts != facts_of(session):
        say(f"--time {options.choice.time}: the capture has changed since its settings were decided, so they are decided again")
        options.choice = replace(options.choice, resolved=())
        session = open_session(options)
    session = sized(session, deadline, say)
    return session, Timed(session, deadline, say)


def expect(session: Session, rows: Sequence[Row]) -> list[Row]:
    """``rows`` with what each stage is expected to take on this machine, as earlier runs of the workspace showed it, and in the time that
    the run may take."""
    if all(row.state != "run" for row in rows):
        return list(rows)
    job = session.job
    known = Known(job.store.root.parent, job.device)
    if session.options.choice.time is None:
        ratio = known.machine_ratio()
        return [row if row.estimate is None else replace(row, estimate=row.estimate * ratio) for row in rows]
    found = {row.stage: row.estimate * known.stage_ratio(row.stage) for row in rows if row.state == "run" and row.estimate is not None}
    before = sum(seconds for stage, seconds in found.items() if stage not in (COARSE, HULLS, FINE, EVALUATION))
    times, decisions, at_one = guessed_times(job, known), Decisions(session), steps_at_one(job)
    left = (seconds_of(session.options.choice.time) - before) - left_to_publish(known)
    fixed = int(decisions.value(STEPS)) if decisions.given(STEPS) or decisions.made_earlier(STEPS) else None
    chosen, evaluation = choose_with(Evaluating(job, known), left, times, at_one, fixed)
    expected = {COARSE: chosen.coarse, HULLS: chosen.hulls, FINE: chosen.fine, EVALUATION: evaluation}
    found |= {stage: seconds for stage, seconds in expected.items() if stage in found}
    return [replace(row, estimate=found.get(row.stage, row.estimate)) for row in rows]
