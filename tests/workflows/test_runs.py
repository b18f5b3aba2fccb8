"""After each stage, a run says what is left by the plan."""

from e4dgs.pipeline import Row
from e4dgs.workflows.runs import left_after

ROWS = [
    Row("frames", "cached", ""),
    Row("flow", "run", "", 30.0),
    Row("seeds", "skip", "", 500.0),
    Row("coarse", "run", "", 90.0),
    Row("report", "run", ""),
]


def test_the_stages_that_follow_and_run_are_left():
    assert left_after("frames", ROWS) == "; about 2 min 00 s left"
    assert left_after("flow", ROWS) == "; about 1 min 30 s left"


def test_nothing_is_said_where_nothing_follows():
    assert left_after("coarse", ROWS) == left_after("report", ROWS) == left_after("unknown", ROWS) == ""
