"""The `seeds` artifact: where Gaussians begin, what of them moves, and depth maps of what is static."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ...pipeline import Artifact, ArtifactWriter, StageError
from ...scene.seeds.moving.moving_seeds import MovingSeeds


@dataclass(frozen=True)
class StoredSeeds:
    """N seeds, and M further ones on moving objects."""

    points: np.ndarray  # [N, 3] float64, world units
    colors: np.ndarray  # [N, 3] float64 in [0, 1]
    dynamic: np.ndarray  # [N] bool: moves at first
    moving: MovingSeeds | None  # on moving objects, at several times; None without masks of what moves
    depth: Mapping[int, np.ndarray]  # inverse depth by frame, [h, w] float32, 1/world unit, 0: unknown; a fixed camera's frames share one
    near: float  # near plane of all cameras, world units, from the points that were measured
    background: tuple[float, float, float]  # RGB in [0, 1]: the capture's, or the mean colour of its pictures
    path_width: float | None  # degrees between the outermost directions from which training frames see a point; None: not along one path

    def write(self, out: ArtifactWriter, png: bytes) -> None:
        """png: a picture of the seeds."""
        out.write("points", self.points, unit="world unit", doc="where Gaussians begin")
        out.write("colors", self.colors, doc="RGB in [0, 1] of points")
        out.write("dynamic", self.dynamic, doc="the point moves at first")
        if self.moving is not None:
            out.write("moving_points", self.moving.points, unit="world unit", doc="seeds on moving objects, each at its own time")
            out.write("moving_colors", self.moving.colors, doc="RGB in [0, 1] of moving_points")
            out.write("moving_velocities", self.moving.velocities, unit="world unit/frame", doc="velocities of moving_points")
            out.write("moving_time", self.moving.time, unit="share of the capture", doc="time in [0, 1] of moving_points")
            if self.moving.held:
                self._write_held(out, self.moving.held)
        out.write("seeds_png", np.frombuffer(png, np.uint8), doc="where training begins, for the report")
        out.attrs.update(near=self.near, background=list(self.background), path_width=self.path_width)
        if self.depth:
            maps = {id(one): one for one in self.depth.values()}  # store each map once
            number = {key: k for k, key in enumerate(maps)}
            doc = "inverse depth of what is static, 0 where unknown"
            out.write("depth_maps", np.stack(list(maps.values())), unit="1/world unit", doc=doc)
            of_frame = np.array([(frame, number[id(one)]) for frame, one in sorted(self.depth.items())], np.int32)
            out.write("depth_of_frame", of_frame, doc="frame, and its row of depth_maps")

    def _write_held(self, out: ArtifactWriter, held: Mapping[int, np.ndarray]) -> None:
        doc = "inverse depth of what moves, 0 where nothing does, and confidence in it"
        out.write("depth_moving", np.stack([held[frame] for frame in sorted(held)]), unit="1/world unit, 1", doc=doc)
        out.write("depth_moving_frame", np.array(sorted(held), np.int32), doc="frame of each row of depth_moving")

    @classmethod
    def read(cls, artifact: Artifact) -> StoredSeeds:
        read, attrs = artifact.read, artifact.attrs
        moving, held = None, read_held(artifact)
        if "moving_points" in artifact:
            moving = MovingSeeds(read("moving_points"), read("moving_colors"), read("moving_velocities"), read("moving_time"), held)
        red, green, blue = attrs["background"]
        return cls(
            points=read("points"),
            colors=read("colors"),
            dynamic=read("dynamic"),
            moving=moving,
            depth=read_depth(artifact),
            near=attrs["near"],
            background=(red, green, blue),
            path_width=attrs["path_width"],
        )


def read_depth(artifact: Artifact | None) -> dict[int, np.ndarray]:
    """`StoredSeeds.depth` alone; empty if the plane sweep found none, or the stage was skipped. Raises ArtifactError if an array is
    damaged."""
    if artifact is None or "depth_maps" not in artifact:
        return {}
    maps = list(artifact.read("depth_maps"))
    return {int(frame): maps[int(k)] for frame, k in artifact.read("depth_of_frame")}


def read_held(artifact: Artifact | None) -> dict[int, np.ndarray]:
    """`MovingSeeds.held` alone, which may be empty. Raises ArtifactError if an array is damaged."""
    if artifact is None or "depth_moving" not in artifact:
        return {}
    frames = artifact.read("depth_moving_frame").tolist()
    return dict(zip(frames, artifact.read("depth_moving"), strict=True))


def read_seeds_png(artifact: Artifact) -> bytes | None:
    """The picture of the seeds as a PNG file; None if there is none."""
    return artifact.read("seeds_png").tobytes() if "seeds_png" in artifact else None


def required(seeds: Artifact | None) -> Artifact:
    """The artifact of `seeds`. Raises StageError if that stage was skipped."""
    if seeds is None:
        raise StageError("there are no seeds to build on; run the stage `seeds` first")
    return seeds
