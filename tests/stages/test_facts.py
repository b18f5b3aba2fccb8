"""What is known of a capture before anything runs: a typed object, and the JSON that plans show."""

from pathlib import Path

import pytest
from e4dgs.stages.captures import recognise
from e4dgs.stages.facts import Facts


@pytest.mark.parametrize("name", ["dnerf", "n3v", "nerfstudio", "video"])
def test_facts_are_the_json_that_plans_show(request, name):
    shown = dict(recognise(request.getfixturevalue(f"{name}_capture").root).facts)
    facts = Facts.of(shown)
    assert (facts.format, facts.frames, facts.splits) == (name, shown["frames"], shown["splits"])
    assert list(facts.as_json().items()) == list(shown.items())


def test_what_is_seldom_true_is_absent_from_the_json_elsewhere():
    assert not {"upright", "untimed", "new_items"} & Facts(frames=3).as_json().keys()
    assert Facts.of(rare := {**Facts(frames=3, upright=True, untimed=True, new_items=0).as_json()}).as_json() == rare
    assert (rare["upright"], rare["untimed"], rare["new_items"]) == (True, True, 0)


def test_a_fact_that_nobody_knows_is_refused_but_other_attributes_of_frames_are_not():
    with pytest.raises(TypeError, match="framse"):
        Facts.of({"framse": 3})
    assert Facts.among({"frames": 3, "names": ["a", "b", "c"]}) == Facts(frames=3)


def test_the_page_of_artifacts_names_every_fact():
    page = (Path(__file__).parents[2] / "docs" / "artifacts.md").read_text()
    table = page[page.index("## Facts") : page.index("## `frames`")]
    assert [name for name in Facts.__dataclass_fields__ if f"`{name}`" not in table] == []
