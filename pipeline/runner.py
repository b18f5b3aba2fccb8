"""Runs a plan: in order, one stage at a time, reusing every result whose key is in the store."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib import metadata
from typing import TYPE_CHECKING, Any, Literal

from .code.edited import refuse_edited
from .earlier import item_digests
from .errors import ArtifactError, DamagedError, PipelineError, StageError
from .job import Job
from .machine.memory import PeakMemory
from .plan import Row, assess
from .progress import Progress
from .stage import Context, Stage
from .storage.adopt import adopt
from .storage.artifact import Artifact
from .storage.room import said_when_full

if TYPE_CHECKING:
    from rich.console import Console


@dataclass(frozen=True)
class Outcome:
    """What became of a stage. ``seconds`` and ``peak_rss_mb`` are those of the run that made the artifact, also when it is cached."""

    stage: str
    state: Literal["ran", "cached", "skipped"]
    reason: str
    seconds: float = 0.0
    peak_rss_mb: float = 0.0
    artifact: Artifact | None = None

    def as_json(self) -> dict[str, Any]:
        return {"state": self.state, "reason": self.reason, "seconds": self.seconds, "peak_rss_mb": self.peak_rss_mb}


class _Damaged(Exception):
    """A result that the run counts on is not as it was written."""

    def __init__(self, stage: str, key: str, error: DamagedError) -> None:
        super().__init__(stage)
        self.stage, self.key, self.error = stage, key, error


class Runner:
    """``report(message)`` receives lines for the user; ``libraries`` are distributions whose versions enter the provenance."""

    def __init__(
        self,
        job: Job,
        report: Callable[[str], None] = lambda message: None,
        console: Console | None = None,
        code_version: str = "",
        libraries: Sequence[str] = ("numpy", "zarr"),
    ) -> None:
        self.job, self._report, self._console = job, report, console
        self._code_version, self._libraries = code_version, libraries
        self._whole: dict[int, Artifact] = {}  # by identity: those of which this run has read, or written, every byte

    def run(
        self,
        targets: Iterable[str] | None = None,
        force: Collection[str] = (),
        finished: Callable[[Outcome], None] = lambda outcome: None,
    ) -> list[Outcome]:
        """Outcomes of the targets (default: all stages) and what they need. ``finished`` is called after each stage.

        A result that turns out to be damaged goes to the store's quarantine and is made again: sizes, descriptions and attrs of everything
        are checked, and every byte of what a stage that runs will read.
        Raises StageError (NoRoomError where a disk is full), CaptureError or SettingsError; a stage that fails or is interrupted leaves its
        checkpoints and nothing else.
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
            except _Damaged as found:
                if (found.stage, found.key) in seen:
                    raise found.error from None  # a disk that spoils what was just written is not for us to mend
                seen.add((found.stage, found.key))
                self._set_aside(found)

    def _all(
        self, stages: Sequence[Stage], force: Collection[str], finished: Callable[[Outcome], None], ran: dict[str, Outcome]
    ) -> list[Outcome]:
        """One pass over the stages. ``ran``: those that an earlier pass of this run has made, which is known of them in this one."""
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

    def _set_aside(self, found: _Damaged) -> None:
        with self.job.store.lock(found.stage, found.key):
            if not self.job.store.has(found.stage, found.key) or not self.job.store.problem(found.stage, found.key):
                return  # another run was faster, and has made it again
            self._quarantine(found.stage, found.key, found.error.problem)

    def _quarantine(self, stage: str, key: str, problem: str) -> None:
        place = self.job.store.quarantine(stage, key)
        self._report(f"{stage}: damaged: {problem}; moved to {place}, and made again")

    def _one(self, stage: Stage, inputs: Mapping[str, Artifact | None], forced: bool) -> Outcome:
        row = assess(self.job, stage, inputs, forced)
        if row.state == "run" or row.source is not None:
            assert row.key is not None
            with self.job.store.lock(stage.name, row.key, lambda: self._report(f"{stage.name}: another process is making it, waiting")):
                row = assess(self.job, stage, inputs, forced)  # the other process may have made it meanwhile
                while row.source is not None:
                    row = self._take_over(stage, row) or assess(self.job, stage, inputs, forced)
                if row.state == "run":
                    self._check(inputs)
                    row = self._sound(stage, row, inputs)
                    if row.damage and row.key is not None:
                        self._quarantine(stage.name, row.key, row.damage)
                    return self._build(stage, inputs, row, forced)
        if row.state == "skip":
            return Outcome(stage.name, "skipped", row.reason)
        assert row.artifact is not None and row.key is not None and row.parts is not None
        self.job.records.write(stage.name, row.key, row.parts, row.artifact.digest)
        try:
            row.artifact.verify(arrays=False)
        except DamagedError as error:
            raise _Damaged(stage.name, row.key, error) from None
        self.job.store.touch(stage.name, row.key)
        made = row.artifact.provenance
        return Outcome(stage.name, "cached", row.reason, made["seconds"], made["peak_rss_mb"], row.artifact)

    def _take_over(self, stage: Stage, row: Row) -> Row | None:
        """The row with its result in our store; None where that of the other store is damaged. Hold the key's lock."""
        assert row.key is not None and row.artifact is not None
        if row.damage:
            self._quarantine(stage.name, row.key, row.damage)
        size = sum(entry[0] for entry in row.artifact.manifest["files"].values())
        try:
            with said_when_full(self.job.store.root, f"{stage.name}, taken from {row.source}", needed=size):
                artifact = adopt(self.job.store, row.artifact, stage.name, row.key)
        except DamagedError as error:
            self.job.refused.add(row.artifact.path)
            self._report(f"{stage.name}: not taken from {row.source}: {error.problem}")
            return None
        self.job.store.drop_checkpoints(stage.name, row.key)
        self._report(f"{stage.name}: taken from {row.source}")
        self._whole[id(artifact)] = artifact
        return replace(row, artifact=artifact, source=None, damage="")

    def _check(self, inputs: Mapping[str, Artifact | None]) -> None:
        """Reads every byte of a stage's inputs, once a run: far quicker than a stage, and none computes on damage."""
        for name, artifact in inputs.items():
            if artifact is None or id(artifact) in self._whole:
                continue
            try:
                artifact.verify()
            except DamagedError as error:
                raise _Damaged(name, artifact.path.name, error) from None
            self._whole[id(artifact)] = artifact

    def _sound(self, stage: Stage, row: Row, inputs: Mapping[str, Artifact | None]) -> Row:
        """The row, every byte of what items are taken over from read; what is damaged is left alone, and the next best looked for."""
        while row.earlier is not None and id(row.earlier.artifact) not in self._whole:
            artifact, place = row.earlier.artifact, None
            try:
                artifact.verify()
            except ArtifactError as error:
                self.job.refused.add(artifact.path)
                if isinstance(error, DamagedError) and artifact.path == self.job.store.path(stage.name, artifact.path.name):
                    place = self.job.store.quarantine_damaged(stage.name, artifact.path.name)
                moved = f"; moved to {place}" if place is not None else ""
                self._report(f"{stage.name}: nothing is taken over from an earlier result: {error}{moved}")
                row = assess(self.job, stage, inputs)
            else:
                self._whole[id(artifact)] = artifact
        return row

    def _build(self, stage: Stage, inputs: Mapping[str, Artifact | None], row: Row, forced: bool) -> Outcome:
        job, key, parts = self.job, row.key, row.parts
        assert key is not None and parts is not None
        if not row.damage:  # has been said
            self._report(f"{stage.name}: {row.reason}")
        if forced:
            job.store.drop_checkpoints(stage.name, key)
        checkpoints = job.store.checkpoints(stage.name, key)
        checkpoints.mkdir(parents=True, exist_ok=True)
        bars: list[Progress] = []
        log: list[str] = []

        def progress(total: int, label: str) -> Progress:
            bars.append(Progress(total, f"{stage.name}: {label}" if label else stage.name, self._console))
            return bars[-1]

        def say(message: str) -> None:
            log.append(message)
            self._report(f"  {stage.name}: {message}")

        start = time.perf_counter()
        try:
            with job.store.writing(stage.name, key) as writer:
                context = Context(
                    job.capture,
                    job.capture.facts,
                    job.settings[stage.name],
                    inputs,
                    writer,
                    checkpoints,
                    job.device,
                    say,
                    progress,
                    row.earlier,
                )
                with said_when_full(job.store.root, stage.name, writer.path):
                    with PeakMemory() as peak:
                        self._call(stage, context)
                    seconds = round(time.perf_counter() - start, 3)
                    provenance = self._provenance(stage, key, parts, seconds, peak.mb, log)
                    if stage.items:
                        earlier = row.earlier.artifact.path.name if row.earlier is not None else None
                        provenance |= {"items": item_digests(job, stage, inputs) if context.lends else [], "earlier": earlier}
                    artifact = self._publish(stage, key, writer, provenance)
        finally:
            for bar in bars:
                bar.close()
            if checkpoints.is_dir() and not any(checkpoints.iterdir()):
                checkpoints.rmdir()
        self._whole[id(artifact)] = artifact
        job.records.write(stage.name, key, parts, artifact.digest)
        return Outcome(stage.name, "ran", row.reason, seconds, peak.mb, artifact)

    def _call(self, stage: Stage, context: Context) -> None:
        refuse_edited(stage, context.device)
        try:
            stage.run(context)
        except PipelineError:
            raise
        except Exception as error:
            raise StageError(f"{stage.name} failed: {type(error).__name__}: {error}") from error

    def _publish(self, stage: Stage, key: str, writer: Any, provenance: Mapping[str, Any]) -> Artifact:
        try:
            return self.job.store.publish(writer, stage.name, key, provenance)
        except StageError as error:
            raise StageError(f"{stage.name}: {error}") from error
        except OSError as error:
            raise StageError(
                f"{stage.name}: its result could not be written to {error.filename or self.job.store.root}: {error}"
            ) from error

    def _provenance(self, stage: Stage, key: str, parts: Mapping[str, Any], seconds: float, peak: float, log: list[str]) -> dict[str, Any]:
        settings = json.loads(self.job.settings[stage.name].model_dump_json())
        return {
            "stage": stage.name,
            "key": key,
            "parts": parts,
            "settings": settings,
            "seeds": {name: value for name, value in settings.items() if name == "seed" or name.endswith("_seed")},
            "device": self.job.device,
            "made": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
            "code_version": self._code_version,
            "libraries": {"python": sys.version.split()[0], **_versions(self._libraries)},
            "seconds": seconds,
            "peak_rss_mb": peak,
            "log": log,
        }


def _versions(names: Sequence[str]) -> dict[str, str]:
    found = {}
    for name in names:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    return found
