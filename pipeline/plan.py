"""What a run would do, stage by stage, and why. Planning runs no stage and imports nothing heavy."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from .earlier import Earlier, find_earlier, made_before
from .errors import ArtifactError, DamagedError
from .job import Job
from .keys import key_of
from .records import differences
from .stage import Stage
from .storage.artifact import Artifact


@dataclass(frozen=True)
class Row:
    """A stage in the plan. ``reason`` says why it is in its state, ``task`` what it does for this capture ("" for skipped rows).
    ``key`` and ``parts`` are None while an input has not been made yet, because they are unknown until then."""

    stage: str
    state: Literal["cached", "run", "skip"]
    reason: str
    estimate: float | None = None  # seconds, for rows that run
    key: str | None = None
    parts: Mapping[str, Any] | None = None
    artifact: Artifact | None = None  # of a cached row
    task: str = ""
    damage: str = ""  # which file of the stored result is damaged, and how
    source: Path | None = None  # for a cached row: another store that holds the result, which has yet to be copied into this one
    earlier: Earlier | None = None  # for a row that runs: the earlier result whose items are reused
    continues: bool = False  # for a row that runs: from a checkpoint

    def as_json(self) -> dict[str, Any]:
        shown = {"stage": self.stage, "state": self.state, "reason": self.reason, "task": self.task}
        return shown | {"estimate_seconds": self.estimate, "key": self.key}


def make_plan(job: Job, targets: Iterable[str] | None = None, force: Collection[str] = ()) -> list[Row]:
    """Rows for the targets (default: all stages) and the stages they need, in running order.

    ``force`` names stages that run even if they are cached.
    """
    names = list(job.graph.stages) if targets is None else list(targets)
    rows: dict[str, Row] = {}
    for stage in job.graph.needed_for(names):
        waiting = [rows[name] for name in stage.inputs if rows[name].state == "run"]
        if waiting and job.graph[stage.name].applies(job.capture.facts, job.settings[stage.name]).needed:
            rows[stage.name] = _unknown(job, stage, waiting, stage.name in force)
        else:
            rows[stage.name] = assess(job, stage, {name: rows[name].artifact for name in stage.inputs}, stage.name in force)
    return list(rows.values())


def assess(job: Job, stage: Stage, inputs: Mapping[str, Artifact | None], forced: bool = False) -> Row:
    """The row of a stage whose inputs are all known (None for a skipped input)."""
    settings = job.settings[stage.name]
    applies = stage.applies(job.capture.facts, settings)
    if not applies.needed:
        return Row(stage.name, "skip", applies.reason)
    parts = job.parts(stage, {name: artifact.digest if artifact else None for name, artifact in inputs.items()})
    key = key_of(parts)
    damage = ""
    if job.store.has(stage.name, key):
        try:
            artifact = job.store.open(stage.name, key)
            if not forced:
                return Row(stage.name, "cached", _cached_reason(job, stage, key), None, key, parts, artifact, applies.reason)
        except DamagedError as error:
            damage = error.problem
    if not forced and (found := _elsewhere(job, stage.name, key)) is not None:
        source, artifact = found
        reason = f"is taken from {source}"
        return Row(stage.name, "cached", reason, None, key, parts, artifact, applies.reason, damage, source)
    reason = "forced" if forced else f"damaged: {damage}" if damage else _run_reason(job, stage, parts, key)
    continues = not forced and _has_entries(job, stage, key)
    if continues:
        reason += "; continues from a checkpoint"
    facts, earlier = job.capture.facts, None if forced else find_earlier(job, stage, parts, key, inputs)
    if earlier is not None:
        reason += f"; {earlier.new} of {earlier.total} {stage.items} are new"
        facts = {**facts, "new_items": earlier.new}
    estimate = stage.estimate(facts, settings)
    return Row(stage.name, "run", reason, estimate, key, parts, task=applies.reason, damage=damage, earlier=earlier, continues=continues)


def _elsewhere(job: Job, stage: str, key: str) -> tuple[Path, Artifact] | None:
    """The first of the other stores that has this result, together with the result; None if no store has it."""
    for store in job.also:
        if store.has(stage, key) and store.path(stage, key) not in job.refused:
            with suppress(ArtifactError):  # we only read this store, so repairing it is left to its owner
                return store.root, store.open(stage, key)
    return None


def _cached_reason(job: Job, stage: Stage, key: str) -> str:
    record = job.records.read(stage.name)
    return "nothing changed" if record is not None and record["key"] == key else "was made before with the same inputs and settings"


def _run_reason(job: Job, stage: Stage, parts: Mapping[str, Any], key: str) -> str:
    record = job.records.read(stage.name)
    if record is None:
        return _without_record(job, stage)
    if record["key"] == key:
        return "its result is no longer in the store"
    return "; ".join(differences(record["parts"], parts))


def _without_record(job: Job, stage: Stage) -> str:
    return "the last run skipped it" if job.records.skipped(stage.name) else "never run for this scene"


def _unknown(job: Job, stage: Stage, waiting: list[Row], forced: bool) -> Row:
    """The row of a stage that waits for another one. Its key is known only once that one is done; if the other's result comes out
    unchanged, this stage need not run."""
    reason = f"after {', '.join(row.stage for row in waiting)}"
    record = job.records.read(stage.name)
    if record is None:
        reason = f"{_without_record(job, stage)}; {reason}"
    else:
        known = {**job.parts(stage, dict.fromkeys(stage.inputs)), "inputs": record["parts"].get("inputs")}
        own = differences(record["parts"], known)
        reason = "; ".join([*own, reason])
        if not forced and (count := made_before(job, stage, known)):
            reason += f"; of {count} {stage.items} made before, those that are unchanged are reused"
    settings = job.settings[stage.name]
    task = stage.applies(job.capture.facts, settings).reason
    return Row(stage.name, "run", reason, stage.estimate(job.capture.facts, settings), task=task)


def _has_entries(job: Job, stage: Stage, key: str) -> bool:
    folder = job.store.checkpoints(stage.name, key)
    return folder.is_dir() and any(folder.iterdir())
