"""The `coarse` artifact apart from its model: how it was trained."""

from __future__ import annotations

from dataclasses import dataclass

from ...pipeline import Artifact, ArtifactWriter, StageError
from ...scene.settings import GrowthSettings, Strategy


@dataclass(frozen=True)
class StoredCoarse:
    """What later stages need from `coarse`, apart from the model (`shared/model.py`)."""

    strategy: Strategy  # `fine` follows it
    iterations: int  # optimiser steps of the stage
    growth: GrowthSettings  # the stage's own; stored only for the joint strategy, otherwise defaults are read back

    def write(self, out: ArtifactWriter) -> None:
        out.attrs.update(strategy=self.strategy, iterations=self.iterations)
        if self.strategy == "joint":
            out.attrs["growth"] = self.growth.model_dump()

    @classmethod
    def read(cls, artifact: Artifact) -> StoredCoarse:
        attrs = artifact.attrs
        growth = dict(attrs.get("growth", {}))
        growth["budget"] = growth.get("budget") or None  # 0 in earlier versions
        return cls(attrs["strategy"], attrs["iterations"], GrowthSettings(**growth))


def required(coarse: Artifact | None) -> Artifact:
    """The artifact of `coarse`. Raises StageError if that stage was skipped."""
    if coarse is None:
        raise StageError("there is no coarse model to build on; run the stage `coarse` first")
    return coarse


def steps_of(coarse: Artifact | None) -> int:
    """Optimiser steps of the stage; 0 if it was skipped."""
    return 0 if coarse is None else int(coarse.attrs.get("iterations", 0))
