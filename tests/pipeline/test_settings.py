"""`stage.key=value`: what is accepted, and what an error tells."""

from pathlib import Path
from typing import ClassVar, Literal

import pytest
from e4dgs.pipeline import Settings, SettingsError, build_settings, settings_by_name, split_assignment
from e4dgs.pipeline.keys import settings_parts
from pydantic import Field, ValidationError


class Fit(Settings):
    renamed: ClassVar = {"steps": "fit.iterations"}
    respelled: ClassVar = {"mode": {"quick": "fast"}}

    iterations: int = Field(100, ge=1, le=5000, description="optimiser steps")
    rate: float = 0.1
    mode: Literal["slow", "fast"] = "slow"
    flag: bool = False
    label: str | None = None
    levels: tuple[int, ...] = (1, 2)
    modes: tuple[Literal["slow", "fast"], ...] | None = Field(None, min_length=1)
    weights: Path | None = None


def fit(*assignments: str) -> Fit:
    pairs = [(f"{stage}.{key}", value) for stage, key, value in map(split_assignment, assignments)]
    built = build_settings({"fit": Fit}, pairs)["fit"]
    assert isinstance(built, Fit)
    return built


def test_values_take_the_type_of_their_field():
    made = fit("fit.iterations=7", "fit.rate=1e-3", "fit.mode=fast", "fit.flag=true", "fit.label=a,b=c", "fit.levels=4,8")
    assert made == Fit(iterations=7, rate=1e-3, mode="fast", flag=True, label="a,b=c", levels=(4, 8))
    assert fit("fit.levels=[1, 3]").levels == (1, 3)
    assert fit("fit.levels=3").levels == (3,) and fit("fit.modes=fast").modes == ("fast",), "a single value is a list of one"
    assert fit("fit.modes=none").modes is None
    assert fit("fit.label=x", "fit.label=none").label is None, "a later assignment wins"


@pytest.mark.parametrize(
    ("assignment", "message"),
    [
        (
            "fit.iterations=0",
            r"fit\.iterations=0: Input should be greater than or equal to 1\n  .*int >= 1 and <= 5000, default 100. optimiser",
        ),
        ("fit.iterations=many", "fit.iterations=many: .*valid integer"),
        ("fit.iterations=many", "unable to parse string as an integer"),
        ("fit.mode=swift", "'slow' or 'fast'"),
        ("fit.levels=some", r"fit\.levels=some: 0: .*valid integer"),
        ("fit.modes=quick", r"fit\.modes=quick: entry 1: 'quick' is not allowed; give 'slow' or 'fast'\n"),
        ("fit.modes=fast,quick", r"fit\.modes=fast,quick: entry 2: 'quick' is not allowed; give 'slow' or 'fast'\n"),
        ("fit.modes=[]", r"fit\.modes=\[\]: give at least 1, separated by commas\n"),
        ("fit.rate=nan", "finite number"),
        ("fit.iteratons=3", r"fit has no setting 'iteratons' \(did you mean 'iterations'\?\); its settings are:\n  fit.iterations: int"),
        ("fot.rate=3", r"there is no stage 'fot' \(did you mean 'fit'\?\); stages: fit"),
        ("fit.rate", "expected stage.key=value"),
        ("rate=3", "expected stage.key=value"),
        (".rate=3", "expected stage.key=value"),
    ],
)
def test_errors_say_what_is_valid(assignment, message):
    with pytest.raises(SettingsError, match=message):
        fit(assignment)


def test_settings_are_frozen_and_refuse_unknown_names():
    with pytest.raises(ValidationError):
        Fit().rate = 1.0
    with pytest.raises(ValidationError):
        Fit(speed=1)


def test_a_copy_has_no_other_names():
    assert Fit().model_copy(update={"rate": 0.5}) == Fit(rate=0.5)
    with pytest.raises(ValueError, match="Fit has no setting raet"):
        Fit().model_copy(update={"raet": 0.5})


def test_a_file_counts_with_its_content(tmp_path):
    first, second = tmp_path / "a.bin", tmp_path / "b.bin"
    first.write_bytes(b"weights")
    second.write_bytes(b"weights")
    assert settings_parts(fit(f"fit.weights={first}")) == settings_parts(fit(f"fit.weights={second}"))
    second.write_bytes(b"others")
    assert settings_parts(fit(f"fit.weights={first}")) != settings_parts(fit(f"fit.weights={second}"))
    with pytest.raises(SettingsError, match=r"weights=.*gone\.bin: there is no such file"):
        settings_parts(fit(f"fit.weights={tmp_path / 'gone.bin'}"))


class Learned(Settings):
    group: ClassVar = "learn"
    renamed: ClassVar = {"lr": "learn.speed"}

    speed: float = Field(0.5, gt=0, description="how fast")
    seed: int = 0


class First(Learned):
    steps: int = 10


class Second(Learned):
    renamed: ClassVar = {"count": "first.steps"}

    steps: int = 20
    seed: int = 7  # its own, in spite of the group's


GROUPED = {"first": First, "second": Second}


def test_a_group_reaches_every_stage_that_shares_it():
    built = build_settings(GROUPED, [("learn.speed", "2"), ("second.steps", "5"), ("learn.seed", 3)])
    assert built["first"] == First(speed=2.0, seed=3) and built["second"] == Second(speed=2.0, steps=5), "the second has its own seed"
    assert list(settings_by_name(GROUPED)) == ["learn.speed", "learn.seed", "first.steps", "second.seed", "second.steps"]


@pytest.mark.parametrize(
    ("older", "line"),
    [
        ("first.speed", "first.speed is now learn.speed, which first and second share"),
        ("second.lr", "second.lr is now learn.speed, which first and second share"),
        ("learn.lr", "learn.lr is now learn.speed, which first and second share"),
        ("second.count", "second.count is now first.steps"),
    ],
)
def test_older_names_are_understood_and_said(older, line):
    lines = []
    built = build_settings(GROUPED, [(older, "4")], lines.append)
    assert lines == [line]
    present = line.split(" is now ")[1].split(",")[0]
    assert built == build_settings(GROUPED, [(present, "4")])


def test_older_values_are_understood_and_said():
    lines = []
    assert build_settings({"fit": Fit}, [("fit.mode", "quick")], lines.append)["fit"] == Fit(mode="fast")
    assert lines == ["fit.mode=quick is now fit.mode=fast"]


def test_a_wrong_key_of_a_group_lists_the_group():
    expected = r"learn has no setting 'sped' \(did you mean 'speed'\?\); its settings are:\n  learn.speed: float > 0"
    with pytest.raises(SettingsError, match=expected):
        build_settings(GROUPED, [("learn.sped", "4")])
    with pytest.raises(SettingsError, match=r"there is no stage 'lean' \(did you mean 'learn'\?\); stages: first, second, learn"):
        build_settings(GROUPED, [("lean.speed", "4")])


def test_a_class_with_older_values_of_its_own_keeps_those_that_it_inherits():
    class Narrow(Fit):
        respelled: ClassVar = {"rate": {"auto": 0.5}}

    built = build_settings({"fit": Narrow}, [("fit.mode", "quick"), ("fit.rate", "auto")])["fit"]
    assert (built.mode, built.rate) == ("fast", 0.5)


class Dropped(Settings):
    dropped: ClassVar = {"size": "pictures have 640 px"}


def test_a_setting_that_is_no_more_is_said_and_has_no_effect():
    lines = []
    assert build_settings({"report": Dropped}, [("report.size", "3")], lines.append)["report"] == Dropped()
    assert lines == ["report.size is no longer a setting and has no effect: pictures have 640 px"]
