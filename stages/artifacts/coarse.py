"""The `coarse` artifact apart from its model: how it was trained, depth maps, and a picture of the seeds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from ...pipeline import Artifact, ArtifactWriter, StageError
from ...scene.settings import GrowthSettings, Strategy


@dataclass(frozen=True)
class StoredCoarse:
    """What later stages need from `coarse`, apart from the model (`model.py`)."""

    strategy: Strategy  # `fine` follows it
    iterations: int  # optimiser steps of the stage
    depth: Mapping[int, np.ndarray]  # inverse depth by frame, [h, w] float32, 1/world unit, 0: unknown; a fixed camera's frames share one
    growth: GrowthSettings  # the stage's own; stored only for the joint strategy, otherwise defaults are read back
    held: Mapping[int, np.ndarray] = field(default_factory=dict)  # by frame, [2, h, w] float32: what `HeldDepth` says

    def write(self, out: ArtifactWriter, seeds_png: bytes) -> None:
        """seeds_png: a picture of the seeds."""
        out.write("seeds_png", np.frombuffer(seeds_png, np.uint8), doc="where training began, for the report")
        out.attrs.update(strategy=self.strategy, iterations=self.iterations)
        if self.strategy == "joint":
            out.attrs["growth"] = self.growth.model_dump()
        if self.depth:
            maps = {id(one): one for one in self.depth.values()}  # store each map once
            number = {key: k for k, key in enumerate(maps)}
            doc = "inverse depth of what is static, 0 where unknown"
            out.write("depth_maps", np.stack(list(maps.values())), unit="1/world unit", doc=doc)
            of_frame = np.array([(frame, number[id(one)]) for frame, one in sorted(self.depth.items())], np.int32)
            out.write("depth_of_frame", of_frame, doc="frame, and its row of depth_maps")
        if self.held:
            doc = "inverse depth of what moves, 0 where nothing does, and confidence in it"
            out.write("depth_moving", np.stack([self.held[frame] for frame in sorted(self.held)]), unit="1/world unit, 1", doc=doc)
            out.write("depth_moving_frame", np.array(sorted(self.held), np.int32), doc="frame of each row of depth_moving")

    @classmethod
    def read(cls, artifact: Artifact) -> StoredCoarse:
        depth: dict[int, np.ndarray] = {}
        if "depth_maps" in artifact:
            maps = list(artifact.read("depth_maps"))
            depth = {int(frame): maps[int(k)] for frame, k in artifact.read("depth_of_frame")}
        held: dict[int, np.ndarray] = {}
        if "depth_moving" in artifact:
            held = dict(zip(artifact.read("depth_moving_frame").tolist(), artifact.read("depth_moving"), strict=True))
        attrs = artifact.attrs
        return cls(attrs["strategy"], attrs["iterations"], depth, GrowthSettings(**attrs.get("growth", {})), held)


def required(coarse: Artifact | None) -> Artifact:
    """The artifact of `coarse`. Raises StageError if that stage was skipped."""
    if coarse is None:
        raise StageError("there is no coarse model to build on; run the stage `coarse` first")
    return coarse


def read_seeds_png(artifact: Artifact) -> bytes | None:
    """The picture of the seeds as a PNG file; None if there is none."""
    return artifact.read("seeds_png").tobytes() if "seeds_png" in artifact else None


def steps_of(coarse: Artifact | None) -> int:
    """Optimiser steps of the stage; 0 if it was skipped."""
    return 0 if coarse is None else int(coarse.attrs.get("iterations", 0))
