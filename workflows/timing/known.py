"""What is known about the speed of this machine: a file of the workspace, written by its runs.

``timing.json`` has, for each machine: how long stages took, as ratios to their estimates; and, from runs that kept to a time, for each
kind of capture the costs of training steps, and by what ratio finished trainings differed from what these made expect.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from ...pipeline import Job, Outcome, thread_count
from ...pipeline.files import read_json, write_json
from ...stages.facts import Facts
from ..machine.devices import processor
from .steps.costs import StepCosts

FILE = "timing.json"
NEW = 0.5  # weight of the newest observation
LEAST, MOST = 0.05, 20.0  # ratios beyond these are accidents
LEAST_SECONDS = 3.0  # taken and expected, from which a time says something about the machine


class Known:
    """The part of ``workspace``'s file that is about this machine and ``device``. Nothing is known if the file cannot be read."""

    def __init__(self, workspace: Path, device: str) -> None:
        self.path, self.machine = workspace / FILE, machine(device)
        content = read_json(self.path)
        self._all: dict[str, Any] = content if isinstance(content, dict) else {}
        mine = self._all.setdefault(self.machine, {})
        self._mine: dict[str, Any] = mine if isinstance(mine, dict) else {}
        self._all[self.machine] = self._mine

    def ratio(self, *names: str) -> float:
        """By what the estimate called ``names`` has to be multiplied; 1 if nothing is known."""
        found = self._ratios().get("/".join(names))
        return min(max(float(found), LEAST), MOST) if isinstance(found, int | float) else 1.0

    def machine_ratio(self) -> float:
        """The same for anything: the middle of the known ratios of whole stages."""
        found = sorted(self.ratio(name) for name in self._ratios() if "/" not in name)
        return found[len(found) // 2] if found else 1.0

    def stage_ratio(self, stage: str) -> float:
        """The ratio of a stage, or of the machine if that is unknown."""
        return self.ratio(stage) if stage in self._ratios() else self.machine_ratio()

    def learn(self, actual: float, expected: float, *names: str) -> None:
        """Takes the time that something took into its ratio, unless it is too short. expected: by an estimate without that ratio."""
        if min(actual, expected) < LEAST_SECONDS:
            return
        key, found = "/".join(names), actual / expected
        earlier = self._ratios().get(key)
        mixed = found if not isinstance(earlier, int | float) else earlier ** (1 - NEW) * found**NEW
        self._ratios()[key] = round(min(max(mixed, LEAST), MOST), 4)

    def learn_stage(self, job: Job, outcome: Outcome) -> None:
        """Takes the time of a stage into its ratio, if it did the whole of its work."""
        if outcome.state != "ran" or outcome.partly:
            return
        estimate = job.graph[outcome.stage].estimate(job.capture.facts, job.settings[outcome.stage])
        if estimate is not None:
            self.learn(outcome.seconds, estimate, outcome.stage)

    def costs(self, kind: str) -> list[StepCosts] | None:
        """The costs of the trainings of `coarse` for captures of this kind; None if they are unknown."""
        try:
            return [StepCosts.of(row) for row in self._table("steps")[kind]] or None
        except (KeyError, TypeError, ValueError):
            return None

    def keep(self, kind: str, costs: Sequence[StepCosts]) -> None:
        """Keeps what was measured."""
        self._table("steps")[kind] = [one.as_json() for one in costs]

    def write(self) -> None:
        """Writes the file; a workspace that can only be read keeps what it has."""
        with suppress(OSError):
            self.path.parent.mkdir(parents=True, exist_ok=True)
            write_json(self.path, self._all)

    def _ratios(self) -> dict[str, Any]:
        return self._table("ratios")

    def _table(self, name: str) -> dict[str, Any]:
        table = self._mine.setdefault(name, {})
        if not isinstance(table, dict):
            table = self._mine[name] = {}
        return table


def machine(device: str) -> str:
    """Processor, number of threads and device. The version belongs to it: another one has other costs."""
    from ... import __version__

    return f"{processor()}, {thread_count()} threads, {device}, {__version__}"


def kind_of(job: Job, settings: Mapping[str, Any]) -> str:
    """The kind of a capture: what the costs of a step depend on before they are measured. settings: those of `coarse`."""
    facts = Facts.of(job.capture.facts)
    marks = {"rig": facts.rig, "static": facts.static, "pairs": facts.pairs > 0, "fixed": facts.fixed_cameras, "alpha": facts.alpha}
    words = [f"{facts.width}x{facts.height}", *(name for name, has in marks.items() if has)]
    changed = {name: value for name, value in settings.items() if name not in ("iterations", "effort", "seed")}
    return " ".join([*words, *(f"{name}={value}" for name, value in sorted(changed.items()))])
