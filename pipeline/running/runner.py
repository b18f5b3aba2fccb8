"""Runs the stages of a plan in order, one at a time, and reuses every result whose key is in the store."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from ..errors import DamagedError
from ..job import Job
from ..plan import assess
from ..stage import Stage
from ..storage.artifact import Artifact
from ..storage.room import said_when_full
from .build import Builder, Outcome
from .trust import Damaged, Trusted

if TYPE_CHECKING:
    from rich.console import Console


class Runner:
    """``report(message)`` receives lines for the user. ``libraries`` are distributions whose versions are recorded in the provenance."""

    def __init__(
        self,
        job: Job,
        report: Callable[[str], None] = lambda message: None,
        console: Console | None = None,
        code_version: str = "",
        libraries: Sequence[str] = ("numpy", "zarr"),
    ) -> None:
        self.job, self._report = job, report
        self._trusted = Trusted(job, report)
        self._builder = Builder(job, report, console, code_version, libraries)

    def run(
        self,
        targets: Iterable[str] | None = None,
        force: Collection[str] = (),
        finished: Callable[[Outcome], None] = lambda outcome: None,
    ) -> list[Outcome]:
        """Runs the targets (default: all stages) and the stages they need; returns their outcomes. ``finished`` is called after each stage.

        A result that turns out to be damaged is moved to the store's quarantine and made again. The sizes, descriptions and attrs of all
        results are checked, and so is every byte of the inputs of a stage that runs.
        Raises StageError (NoRoomError if a disk is full), CaptureError or SettingsError. A stage that fails or is interrupted leaves
        nothing behind but its checkpoints.
        """
        with said_when_full(self.job.store.root):
            return self._until_whole(targets, force, finished)

    def _until_whole(self, targets: Iterable[str] | None, force: Collection[str], finished: Callable[[Outcome], None]) -> list[Outcome]:
        stages = self.job.graph.needed_for(list(self.job.graph.stages) if targets is None else list(targets))
        ran: dict[str, Outcome] = {}
        seen: set[tuple[str, str]] = set()
        while True:
            try:
                return self._all(stages, force, finished, ran)
            except Damaged as found:
                if (found.stage, found.key) in seen:
                    raise found.error from None  # the disk damages what was just written, so trying again is pointless
                seen.add((found.stage, found.key))
                self._trusted.set_aside(found)

    def _all(
        self, stages: Sequence[Stage], force: Collection[str], finished: Callable[[Outcome], None], ran: dict[str, Outcome]
    ) -> list[Outcome]:
        """One pass over the stages. ``ran``: outcomes of the stages built in an earlier pass of this run; this pass adds its own."""
        outcomes: dict[str, Outcome] = {}
        for stage in stages:
            inputs = {name: outcomes[name].artifact for name in stage.inputs}
            before = ran.get(stage.name)
            outcome = self._one(stage, inputs, stage.name in force and before is None)
            if before is not None and outcome.state == "cached":
                outcome = replace(before, artifact=outcome.artifact)
            else:
                finished(outcome)
            if outcome.state == "ran":
                ran[stage.name] = outcome
            outcomes[stage.name] = outcome
        return list(outcomes.values())

    def _one(self, stage: Stage, inputs: Mapping[str, Artifact | None], forced: bool) -> Outcome:
        row = assess(self.job, stage, inputs, forced)
        if row.state == "run" or row.source is not None:
            assert row.key is not None
            with self.job.store.lock(stage.name, row.key, lambda: self._report(f"{stage.name}: another process is computing it; waiting")):
                row = assess(self.job, stage, inputs, forced)  # the other process may have made it meanwhile
                while row.source is not None:
                    row = self._trusted.take_over(stage, row) or assess(self.job, stage, inputs, forced)
                if row.state == "run":
                    self._trusted.check(inputs)
                    row = self._trusted.lender(stage, row, inputs)
                    if row.damage and row.key is not None:
                        self._trusted.quarantine(stage.name, row.key, row.damage)
                    outcome = self._builder.build(stage, inputs, row, forced)
                    assert outcome.artifact is not None
                    self._trusted.add(outcome.artifact)
                    return outcome
        if row.state == "skip":
            self.job.records.skip(stage.name)  # or the scene would seem to use a result of earlier settings
            return Outcome(stage.name, "skipped", row.reason)
        assert row.artifact is not None and row.key is not None and row.parts is not None
        self.job.records.write(stage.name, row.key, row.parts, row.artifact.digest)
        try:
            row.artifact.verify(arrays=False)
        except DamagedError as error:
            raise Damaged(stage.name, row.key, error) from None
        self.job.store.touch(stage.name, row.key)
        made = row.artifact.provenance
        return Outcome(stage.name, "cached", row.reason, made["seconds"], made["peak_rss_mb"], row.artifact)
