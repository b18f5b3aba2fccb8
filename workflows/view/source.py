"""Where the viewer's model comes from: the store if the run is finished, the newest checkpoint while it trains."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

from ...pipeline import Artifact, Row, make_plan
from ...scene.model import Model
from ...scene.training.checkpoint import FILE, model_of
from ...stages.shared.model import read_model
from ..last_run import decided_for
from ..results import made, missing
from ..session import Session, open_session
from ..which_scene import NoRunError

TRAINED = ("fine", "coarse")  # best first


class Found(NamedTuple):
    """A model and its title."""

    model: Model
    title: str


class Source:
    """Finds the best model available now for ``session``'s capture and settings."""

    def __init__(self, session: Session) -> None:
        self.session = session
        self.final = False  # whether the model found last is the result of the finished run
        self._earlier: dict[str, Artifact | None] | None = None  # results of the last run, if the plan does not find them any more
        self._mark: tuple[str, str] | None = None  # identifies the model found last

    def newest(self) -> Found | None:
        """The best model if it differs from the one found last, else None."""
        self._follow()
        rows = {row.stage: row for row in make_plan(self.session.job)}
        wanted = [stage for stage in TRAINED if rows[stage].state != "skip"]
        for stage in wanted:
            mark = self._mark_of(rows[stage])
            if mark is None or mark == self._mark:
                if mark is not None:
                    return None
                continue
            found = self._load(rows[stage])
            if found is None:
                continue
            self._mark, self.final = mark, stage == wanted[0] and rows[stage].state == "cached"
            return found
        return self._of_last_run(wanted) if self.session.options.last and self._mark is None else None

    def frames(self) -> tuple[Artifact, Artifact | None] | None:
        """The artifacts `frames` and `poses` (None if the capture's files hold poses); None as long as they do not exist."""
        frames, poses = make_plan(self.session.job, ["frames", "poses"])
        if frames.artifact is not None and poses.state != "run":
            return frames.artifact, poses.artifact
        earlier = self._earlier or {}
        first = earlier.get("frames")
        return None if first is None else (first, earlier.get("poses"))

    def missing(self) -> NoRunError:
        """The error for when there is nothing to show."""
        wanted = next(row for row in make_plan(self.session.job) if row.stage == "coarse")
        return missing(self.session, wanted, "all")

    def _follow(self) -> None:
        """Takes over what a run that keeps to a time has decided meanwhile."""
        options = self.session.options
        run = decided_for(options) if options.choice.time is not None else None
        if run is not None and run.choice != options.choice:
            self.session = open_session(replace(options, choice=run.choice))

    def _of_last_run(self, wanted: Sequence[str]) -> Found | None:
        """The model that the last run made, where the code or the capture has changed since."""
        for stage in wanted:
            if (earlier := made(self.session, stage)) is not None and (artifact := earlier[stage]) is not None:
                self._earlier, self._mark, self.final = earlier, (stage, artifact.digest), True
                return Found(read_model(artifact).to(self.session.job.device), f"{stage}, finished")
        return None

    def _mark_of(self, row: Row) -> tuple[str, str] | None:
        if row.artifact is not None:
            return row.stage, row.artifact.digest
        if row.key is None:
            return None
        file = self.session.job.store.checkpoints(row.stage, row.key) / FILE
        return (row.stage, str(file.stat().st_mtime_ns)) if file.is_file() else None

    def _load(self, row: Row) -> Found | None:
        device = self.session.job.device
        if row.artifact is not None:
            return Found(read_model(row.artifact).to(device), f"{row.stage}, finished")
        assert row.key is not None
        loaded = model_of(self.session.job.store.checkpoints(row.stage, row.key))
        return None if loaded is None else Found(loaded[0].to(device), f"{row.stage}, step {loaded[1]:,}")
