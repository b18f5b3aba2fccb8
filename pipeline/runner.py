"""Runs a plan: in order, one stage at a time, reusing every result whose key is in the store."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from importlib import metadata
from typing import TYPE_CHECKING, Any, Literal

from .artifact import Artifact
from .errors import PipelineError, SettingsError, StageError
from .job import Job
from .memory import PeakMemory
from .plan import Row, assess
from .progress import Progress
from .stage import Context, Stage

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

    def run(
        self,
        targets: Iterable[str] | None = None,
        force: Collection[str] = (),
        finished: Callable[[Outcome], None] = lambda outcome: None,
    ) -> list[Outcome]:
        """Outcomes of the targets (default: all stages) and what they need. ``finished`` is called after each stage.

        Raises StageError, CaptureError or SettingsError; a stage that fails or is interrupted leaves its checkpoints and nothing else.
        """
        names = list(self.job.graph.stages) if targets is None else list(targets)
        outcomes: dict[str, Outcome] = {}
        for stage in self.job.graph.needed_for(names):
            inputs = {name: outcomes[name].artifact for name in stage.inputs}
            outcome = self._one(stage, inputs, stage.name in force)
            outcomes[stage.name] = outcome
            finished(outcome)
        return list(outcomes.values())

    def _one(self, stage: Stage, inputs: Mapping[str, Artifact | None], forced: bool) -> Outcome:
        digests = {name: artifact.digest if artifact else None for name, artifact in inputs.items()}
        row = assess(self.job, stage, digests, forced)
        if row.state == "run":
            assert row.key is not None
            with self.job.store.lock(stage.name, row.key, lambda: self._report(f"{stage.name}: another process is making it, waiting")):
                row = assess(self.job, stage, digests, forced)  # the other process may have made it meanwhile
                if row.state == "run":
                    return self._build(stage, inputs, row, forced)
        if row.state == "skip":
            return Outcome(stage.name, "skipped", row.reason)
        assert row.artifact is not None and row.key is not None and row.parts is not None
        self.job.records.write(stage.name, row.key, row.parts, row.artifact.digest)
        made = row.artifact.provenance
        return Outcome(stage.name, "cached", row.reason, made["seconds"], made["peak_rss_mb"], row.artifact)

    def _build(self, stage: Stage, inputs: Mapping[str, Artifact | None], row: Row, forced: bool) -> Outcome:
        job, key, parts = self.job, row.key, row.parts
        assert key is not None and parts is not None
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
                    job.capture, job.capture.facts, job.settings[stage.name], inputs, writer, checkpoints, job.device, say, progress
                )
                with PeakMemory() as peak:
                    self._call(stage, context)
                seconds = round(time.perf_counter() - start, 3)
                provenance = self._provenance(stage, key, parts, seconds, peak.mb, log)
                artifact = self._publish(stage, key, writer, provenance)
        finally:
            for bar in bars:
                bar.close()
            if checkpoints.is_dir() and not any(checkpoints.iterdir()):
                checkpoints.rmdir()
        job.records.write(stage.name, key, parts, artifact.digest)
        return Outcome(stage.name, "ran", row.reason, seconds, peak.mb, artifact)

    def _call(self, stage: Stage, context: Context) -> None:
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


def check_targets(graph_names: Iterable[str], target: str) -> list[str] | None:
    """``"all"`` -> None (every stage), a stage's name -> that name alone; raises SettingsError for anything else."""
    names = list(graph_names)
    if target == "all":
        return None
    if target not in names:
        raise SettingsError(f"there is no stage {target!r}; give one of: all, {', '.join(names)}")
    return [target]
