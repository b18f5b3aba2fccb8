"""Runs a stage up to its training, so that its steps can be measured."""

from __future__ import annotations

import time
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from ....pipeline import Artifact, Job, Settings
from ....stages.shared.rehearsal import Enough, Rehearsal, Training

MAIN = ("coarse", "fine")  # names of the trainings that a stage is there for


@dataclass(frozen=True)
class Rehearsed:
    """The trainings of a stage, in order, and the seconds that it took before them. None is there if the stage trains nothing."""

    trainings: list[Training]
    seconds: float


class _Nowhere:
    """Takes what a rehearsed stage writes, and keeps nothing."""

    def __init__(self, path: Path) -> None:
        vars(self).update(path=path, attrs={}, info={})

    def write(self, *args: Any, **kwargs: Any) -> None:
        pass


class _Silent:
    """A progress bar that shows nothing."""

    def __enter__(self) -> _Silent:
        return self

    def __exit__(self, *error: object) -> None:
        pass

    def advance(self, n: int = 1, note: str = "") -> None:
        pass


def rehearse(job: Job, stage: str, settings: Settings, inputs: Mapping[str, Artifact | None]) -> Rehearsed:
    """Runs ``stage`` up to its training and no further. Nothing is written."""
    found: list[Training] = []

    def handed(training: Training) -> None:
        found.append(training)
        if training.name in MAIN:
            raise Enough

    begin = time.perf_counter()
    with TemporaryDirectory(prefix="e4dgs-") as folder:
        context = Rehearsal(
            job.capture,
            job.capture.facts,
            settings,
            inputs,
            _Nowhere(Path(folder)),  # type: ignore[arg-type]
            Path(folder),
            job.device,
            lambda message: None,
            lambda total, label: _Silent(),  # type: ignore[arg-type, return-value]
            handed=handed,
        )
        with suppress(Enough):
            job.graph[stage].run(context)
    return Rehearsed(found, time.perf_counter() - begin)
