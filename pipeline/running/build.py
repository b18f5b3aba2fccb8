"""Builds one stage: runs it, publishes what it wrote, and records how it was made."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib import metadata
from typing import TYPE_CHECKING, Any, Literal

from ..code.edited import refuse_edited
from ..earlier import item_digests
from ..errors import PipelineError, StageError
from ..job import Job
from ..machine.memory import PeakMemory
from ..plan import Row
from ..stage import Context, Stage
from ..storage.artifact import Artifact
from ..storage.room import said_when_full
from .progress import Progress

if TYPE_CHECKING:
    from rich.console import Console


@dataclass(frozen=True)
class Outcome:
    """What happened to a stage. ``seconds`` and ``peak_rss_mb`` describe the run that made the artifact, even if it is cached now."""

    stage: str
    state: Literal["ran", "cached", "skipped"]
    reason: str
    seconds: float = 0.0
    peak_rss_mb: float = 0.0
    artifact: Artifact | None = None
    partly: bool = False  # it did a part of its work, and the rest had been done: by an earlier result, or up to a checkpoint

    def as_json(self) -> dict[str, Any]:
        return {"state": self.state, "reason": self.reason, "seconds": self.seconds, "peak_rss_mb": self.peak_rss_mb}


class Builder:
    """``report(message)`` receives lines for the user. ``libraries`` are distributions whose versions are recorded in the provenance."""

    def __init__(
        self, job: Job, report: Callable[[str], None], console: Console | None, code_version: str, libraries: Sequence[str]
    ) -> None:
        self.job, self._report, self._console = job, report, console
        self._code_version, self._libraries = code_version, libraries

    def build(self, stage: Stage, inputs: Mapping[str, Artifact | None], row: Row, forced: bool) -> Outcome:
        """Builds the stage. The caller must hold the key's lock. forced: checkpoints of earlier runs are dropped first. Whatever the stage
        raises arrives as a PipelineError."""
        job, key, parts = self.job, row.key, row.parts
        assert key is not None and parts is not None
        if not row.damage:  # damage has already been reported
            self._report(f"{stage.name}: {row.reason}")
        if forced:
            job.store.drop_checkpoints(stage.name, key)
        checkpoints = job.store.checkpoints(stage.name, key)
        checkpoints.mkdir(parents=True, exist_ok=True)
        bars: list[Progress] = []
        log: list[str] = []

        def progress(total: int, label: str) -> Progress:
            bars.append(Progress(total, f"{stage.name}: {label}" if label not in ("", stage.name) else stage.name, self._console))
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
        job.records.write(stage.name, key, parts, artifact.digest)
        return Outcome(stage.name, "ran", row.reason, seconds, peak.mb, artifact, partly=row.continues or row.earlier is not None)

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
