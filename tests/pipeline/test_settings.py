"""`stage.key=value`: what is accepted, and what an error tells."""

from pathlib import Path
from typing import ClassVar, Literal

import pytest
from e4dgs.pipeline import Settings, SettingsError, build_settings, split_assignment
from e4dgs.pipeline.keys import settings_parts
from pydantic import Field, ValidationError


class Fit(Settings):
    renamed: ClassVar = {"steps": "iterations"}

    iterations: int = Field(100, ge=1, le=5000, description="optimiser steps")
    rate: float = 0.1
    mode: Literal["slow", "fast"] = "slow"
    flag: bool = False
    label: str | None = None
    levels: tuple[int, ...] = (1, 2)
    modes: tuple[Literal["slow", "fast"], ...] | None = None
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
        ("fit.mode=quick", "'slow' or 'fast'"),
        ("fit.levels=some", r"fit\.levels=some: 0: .*valid integer"),
        ("fit.modes=quick", "0: Input should be 'slow' or 'fast'"),
        ("fit.rate=nan", "finite number"),
        ("fit.iteratons=3", r"fit has no setting 'iteratons' \(did you mean 'iterations'\?\); its settings are:\n  fit.iterations: int"),
        ("fit.steps=3", r"fit has no setting 'steps' \(it is now 'iterations'\); its settings are:\n  fit.iterations: int"),
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


def test_a_file_counts_with_its_content(tmp_path):
    first, second = tmp_path / "a.bin", tmp_path / "b.bin"
    first.write_bytes(b"weights")
    second.write_bytes(b"weights")
    assert settings_parts(fit(f"fit.weights={first}")) == settings_parts(fit(f"fit.weights={second}"))
    second.write_bytes(b"others")
    assert settings_parts(fit(f"fit.weights={first}")) != settings_parts(fit(f"fit.weights={second}"))
    with pytest.raises(SettingsError, match=r"weights=.*gone\.bin: there is no such file"):
        settings_parts(fit(f"fit.weights={tmp_path / 'gone.bin'}"))
