"""The `poses` artifact: cameras and points from structure from motion, and statistics of the reconstruction."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypedDict, Unpack

import numpy as np

from ...pipeline import Artifact, ArtifactWriter


@dataclass(frozen=True, kw_only=True)
class StoredPoses:
    """Cameras of F frames, NaN for frames that are not registered, and P points. The scale is set so that the median distance of the
    registered cameras to the median point is 4 world units."""

    K: np.ndarray  # [F, 3, 3] float64 px, of the undistorted pictures
    cam_from_world: np.ndarray  # [F, 4, 4] float64, OpenCV
    distortion: np.ndarray  # [F, 4] float64: k1 k2 p1 p2
    registered: np.ndarray  # [F] bool
    points: np.ndarray  # [P, 3] float64, world units
    point_colors: np.ndarray  # [P, 3] uint8
    lens_K: np.ndarray | None = None  # [F, 3, 3] float64 px, of the distorted pictures; None if equal to K
    fixed_cameras: bool | None = None  # whether all cameras stand still; for reading only, `write_account` writes it
    point_errors: np.ndarray | None = None  # [P] float64 px, mean reprojection error; for people, so it is not read back

    fisheye = None  # no fisheye model is fitted

    def write(self, out: ArtifactWriter) -> None:
        assert self.point_errors is not None
        out.write("K", self.K, unit="px", doc="intrinsics of the undistorted pictures, pixel centres at +0.5; NaN where not registered")
        if self.lens_K is not None:
            out.write("lens_K", self.lens_K, unit="px", doc="intrinsics of the pictures as the lens made them; NaN where not registered")
        out.write("cam_from_world", self.cam_from_world, unit="world", doc="OpenCV pose of the camera; NaN where not registered")
        out.write("distortion", self.distortion, doc="k1 k2 p1 p2")
        out.write("registered", self.registered, doc="the frame has a pose")
        out.write("points", self.points, unit="world", doc="triangulated points")
        out.write("point_colors", self.point_colors, doc="RGB of points")
        out.write("point_errors", self.point_errors, unit="px", doc="mean reprojection error of each point")

    @classmethod
    def read(cls, artifact: Artifact) -> StoredPoses:
        read = artifact.read
        return cls(
            K=read("K"),
            cam_from_world=read("cam_from_world"),
            distortion=read("distortion"),
            registered=read("registered"),
            points=read("points"),
            point_colors=read("point_colors"),
            lens_K=read("lens_K") if "lens_K" in artifact else None,
            fixed_cameras=artifact.attrs.get("fixed_cameras"),
        )


class Account(TypedDict, total=False):
    """Statistics and notes of the reconstruction, stored as attributes of the artifact."""

    registered: int  # frames with a pose
    total: int  # frames
    gaps: Sequence[Sequence[int]]  # first and last frame of each run of frames without a pose
    mean_reprojection_error: float  # px, over observations of the points that are kept
    median_reprojection_error: float
    mean_track_length: float  # images per point
    median_angle: float  # degrees between the outermost rays of a point
    parts: Sequence[Sequence[int]]  # images of each part of the reconstruction, the kept part first
    notes: Sequence[str]  # what was removed, undone, joined or assumed
    advice: Sequence[str]  # problems, and what to do about them
    camera_model: str
    mapper: str
    matcher: str
    fixed_cameras: bool  # whether all cameras stand still
    limits: str  # how far the result can be trusted beside the cameras, for people
    moving_share: float | None  # share of the features triangulated in the first pass that lie on moving objects
    second_pass: str  # which pass was kept, and why


def write_account(out: ArtifactWriter, **account: Unpack[Account]) -> None:
    """Writes some of the attributes of `Account`; others may be written before or after."""
    out.attrs.update(account)


def found_fixed(artifact: Artifact | None) -> bool:
    """`Account.fixed_cameras`; False without the stage or where it says nothing."""
    return artifact is not None and bool(artifact.attrs.get("fixed_cameras"))


def read_limits(artifact: Artifact) -> str | None:
    """`Account.limits`; None if nothing special limits the result."""
    limits: str | None = artifact.attrs.get("limits")
    return limits
