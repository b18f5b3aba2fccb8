"""The `hulls` artifact: initial shapes of the convexes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...pipeline import Artifact, ArtifactWriter


@dataclass(frozen=True)
class StoredHulls:
    """M convexes of K points each."""

    points: np.ndarray  # [M, K, 3] float32, world units, in the rest pose
    colors: np.ndarray  # [M, 3] float32 in [0, 1]
    seed: np.ndarray  # [M] int32, row in `coarse` of the Gaussian that each came from
    edge_density: np.ndarray  # [M] float32, mean edge weight under that Gaussian
    k: int  # K
    reason: str  # how many there are and why, for people

    def __len__(self) -> int:
        return len(self.points)

    def write(self, out: ArtifactWriter) -> None:
        out.write("points", self.points, unit="world unit")
        out.write("colors", self.colors)
        out.write("seed", self.seed, doc="row of the Gaussian in `coarse`")
        out.write("edge_density", self.edge_density, doc="mean edge weight under the seed")
        out.attrs.update(k=self.k, reason=self.reason)

    @classmethod
    def read(cls, artifact: Artifact) -> StoredHulls:
        read, attrs = artifact.read, artifact.attrs
        return cls(read("points"), read("colors"), read("seed"), read("edge_density"), attrs["k"], attrs["reason"])
