"""After each stage, a run says what is left: by the plan, and by how long its stages have taken so far."""

from e4dgs.pipeline import Outcome, Row
from e4dgs.workflows.timing.left import Left

ROWS = [
    Row("frames", "cached", ""),
    Row("flow", "run", "", 30.0),
    Row("seeds", "skip", "", 500.0),
    Row("coarse", "run", "", 90.0),
    Row("report", "run", ""),
]


def done(stage, seconds, state="ran"):
    return Outcome(stage, state, "", seconds)


def test_the_stages_that_follow_and_run_are_left():
    left = Left(ROWS)
    assert left.after(done("frames", 700.0, "cached")) == "; about 2 min 00 s left"
    assert left.after(done("flow", 30.0)) == "; about 1 min 30 s left"


def test_a_run_that_is_faster_than_planned_has_less_left():
    assert Left(ROWS).after(done("flow", 7.5)) == "; about 1 min 08 s left", "(60 + 7.5) of (60 + 30)"
    assert Left(ROWS).after(done("flow", 75.0)) == "; about 2 min 15 s left"


def test_nothing_is_said_where_nothing_follows():
    assert {Left(ROWS).after(done(stage, 1.0)) for stage in ("coarse", "report", "unknown")} == {""}
