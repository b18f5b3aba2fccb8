"""The artifacts that a run trusts because it has read every byte of them, and the handling of those that turn out to be damaged."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

from ..errors import ArtifactError, DamagedError
from ..job import Job
from ..plan import Row, assess
from ..stage import Stage
from ..storage.adopt import adopt
from ..storage.artifact import Artifact
from ..storage.room import said_when_full


class Damaged(Exception):
    """A result that the run depends on differs from what was written."""

    def __init__(self, stage: str, key: str, error: DamagedError) -> None:
        super().__init__(stage)
        self.stage, self.key, self.error = stage, key, error


class Trusted:
    """The artifacts that one run has fully read or written itself. ``report(message)`` receives lines for the user."""

    def __init__(self, job: Job, report: Callable[[str], None]) -> None:
        self.job, self._report = job, report
        self._whole: dict[int, Artifact] = {}  # by identity

    def add(self, artifact: Artifact) -> None:
        self._whole[id(artifact)] = artifact

    def check(self, inputs: Mapping[str, Artifact | None]) -> None:
        """Reads every byte of a stage's inputs, once per run. That is far quicker than a stage, and no stage computes on damaged data.
        Raises Damaged."""
        for name, artifact in inputs.items():
            if artifact is None or id(artifact) in self._whole:
                continue
            try:
                artifact.verify()
            except DamagedError as error:
                raise Damaged(name, artifact.path.name, error) from None
            self.add(artifact)

    def lender(self, stage: Stage, row: Row, inputs: Mapping[str, Artifact | None]) -> Row:
        """Verifies every byte of the earlier result whose items the row reuses. If it is damaged, it is not used (and goes to quarantine if
        it lies in our own store), and the next best result is tried. Returns the row to build."""
        while row.earlier is not None and id(row.earlier.artifact) not in self._whole:
            artifact, place = row.earlier.artifact, None
            try:
                artifact.verify()
            except ArtifactError as error:
                self.job.refused.add(artifact.path)
                if isinstance(error, DamagedError) and artifact.path == self.job.store.path(stage.name, artifact.path.name):
                    place = self.job.store.quarantine_damaged(stage.name, artifact.path.name)
                moved = f"; moved to {place}" if place is not None else ""
                self._report(f"{stage.name}: nothing is reused from an earlier result: {error}{moved}")
                row = assess(self.job, stage, inputs)
            else:
                self.add(artifact)
        return row

    def take_over(self, stage: Stage, row: Row) -> Row | None:
        """Copies the row's result from the other store into ours and returns the updated row, or None if the other store's result is
        damaged. The caller must hold the key's lock."""
        assert row.key is not None and row.artifact is not None
        if row.damage:
            self.quarantine(stage.name, row.key, row.damage)
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
        self.add(artifact)
        return replace(row, artifact=artifact, source=None, damage="")

    def set_aside(self, found: Damaged) -> None:
        """Moves a damaged result to the quarantine, unless it has been repaired in the meantime."""
        with self.job.store.lock(found.stage, found.key):
            if not self.job.store.has(found.stage, found.key) or not self.job.store.problem(found.stage, found.key):
                return  # another run has already dealt with it
            self.quarantine(found.stage, found.key, found.error.problem)

    def quarantine(self, stage: str, key: str, problem: str) -> None:
        """Moves a result to the quarantine and reports it. The caller must hold the key's lock."""
        place = self.job.store.quarantine(stage, key)
        self._report(f"{stage}: damaged: {problem}; moved to {place}, and made again")
