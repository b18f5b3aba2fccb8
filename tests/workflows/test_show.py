"""Lines of a plan about settings that change nothing, because the stages that have them are skipped."""

from types import SimpleNamespace

from e4dgs.pipeline import Row
from e4dgs.workflows.reconstruction import reconstruction
from e4dgs.workflows.session import Choice
from e4dgs.workflows.show import without_effect

SKIPPED = {"flow": "no camera saw two times", "hulls": "hulls.budget is 0", "fine": "fine.iterations is 0"}


def lines(*assignments):
    graph = reconstruction()
    rows = [Row(name, "skip" if name in SKIPPED else "run", SKIPPED.get(name, "never run")) for name in graph.stages]
    options = SimpleNamespace(choice=Choice(set=assignments))
    return without_effect(rows, SimpleNamespace(job=SimpleNamespace(graph=graph), options=options))


def test_a_setting_of_a_skipped_stage_is_named():
    assert lines("flow.weights=x.pth") == ["flow.weights changes nothing here: flow is skipped (no camera saw two times)"]


def test_what_decides_or_is_used_elsewhere_is_not():
    assert lines("hulls.budget=0", "fine.iterations=0", "coarse.iterations=3", "train.budget=9", "train.seed=1", "no.such=1") == []
