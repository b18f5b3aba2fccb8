"""The `depth` artifact: depth maps of training frames, in world units."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ...pipeline import Artifact, ArtifactWriter

PRECISE = 0.02  # error below which single pixels are believed; above it only what many of them agree on


@dataclass(frozen=True)
class StoredDepth:
    """kind: what the depth was up to, see `vision.depth.align`. error: median of how far known points are from it, as a share of their
    depth. z: by frame, depth [h, w] float32 along the optical axis, world units, 0 where it is unknown. confidence: by frame, [h, w]
    float32 in [0, 1]."""

    kind: str
    error: float
    z: Mapping[int, np.ndarray]
    confidence: Mapping[int, np.ndarray]

    @property
    def precise(self) -> bool:
        """Whether single pixels are to be believed."""
        return self.error < PRECISE

    def write(self, out: ArtifactWriter, fits: Mapping[int, np.ndarray], errors: Mapping[int, float]) -> None:
        """fits, errors: of each frame, see `Alignment`. Depth is stored in half precision, as a multiple of a typical depth."""
        frames = sorted(self.z)
        some = np.concatenate([self.z[i][self.z[i] > 0][::101] for i in frames])
        unit = float(np.median(some)) if len(some) else 1.0
        maps = np.stack([self.z[i] / unit for i in frames])
        known = np.where(maps > 0, np.clip(maps, 1e-4, 6e4), 0).astype(np.float16)
        out.write("depth_frame", np.array(frames, np.int32), doc="frame of each row of depth")
        out.write("depth", known, unit="depth_unit", doc="distance along the optical axis, 0 where unknown")
        sure = np.stack([self.confidence[i] for i in frames])
        out.write("confidence", np.rint(255 * sure).astype(np.uint8), unit="1/255", doc="confidence in depth")
        out.write("fit", np.stack([fits[i] for i in frames]), doc="scale, and shift where there is one, by which the values were aligned")
        out.write(
            "fit_error", np.array([errors[i] for i in frames]), doc="median relative error at known points; NaN: aligned as neighbours"
        )
        out.attrs.update(kind=self.kind, error=self.error, depth_unit=unit)


def write_points(out: ArtifactWriter, points: np.ndarray, colors: np.ndarray) -> None:
    """The points [P, 3] that were triangulated to align depth, with their colours [P, 3] uint8, for a capture without any."""
    out.write("points", points, unit="world", doc="triangulated points")
    out.write("point_colors", colors, doc="RGB of points")


def read_depth(artifact: Artifact | None) -> StoredDepth | None:
    """None if the stage was skipped, or no frame has depth that could be aligned. Raises ArtifactError if an array is damaged."""
    if artifact is None or "depth" not in artifact:
        return None
    frames = artifact.read("depth_frame").tolist()
    maps = artifact.read("depth").astype(np.float32) * np.float32(artifact.attrs["depth_unit"])
    sure = artifact.read("confidence").astype(np.float32) / np.float32(255)
    kind, error = artifact.attrs["kind"], artifact.attrs["error"]
    return StoredDepth(kind, error, dict(zip(frames, maps, strict=True)), dict(zip(frames, sure, strict=True)))


def read_points(artifact: Artifact | None) -> tuple[np.ndarray, np.ndarray] | None:
    """What `write_points` wrote; None if nothing."""
    if artifact is None or "points" not in artifact:
        return None
    return artifact.read("points"), artifact.read("point_colors")
