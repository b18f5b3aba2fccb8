"""The cameras of a capture in a USD stage, so that film tools look through the lens that filmed the scene."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..axes import OPENGL

APERTURE = 36.0  # mm, width of the assumed sensor; only its ratio to the focal length is known
FAR = 1e6  # times the near plane


@dataclass(frozen=True)
class PosedCamera:
    """A camera over time. time [n] in [0, 1], sorted; cam_from_world [n, 4, 4] OpenCV, world units; K [n, 3, 3] px of pinhole pictures of
    ``width`` x ``height``; near: depth at which the scene begins, world units."""

    name: str
    time: np.ndarray
    cam_from_world: np.ndarray
    K: np.ndarray
    width: int
    height: int
    near: float

    def codes(self, last_code: float) -> np.ndarray:
        """[n]: time code of each pose, where time t is t * ``last_code``; 0, 1, 2 and so on if all show one time, as of somebody who walks
        around a scene that stands still."""
        return self.time * last_code if np.ptp(self.time) > 0 < last_code else np.arange(len(self.time), dtype=np.float64)


def define_cameras(stage: Any, parent: str, cameras: Sequence[PosedCamera], last_code: float) -> None:
    """Adds ``cameras`` under the prim ``parent`` of a Usd.Stage, in whose space their poses are, with a sample for each pose.

    The stage ends with a walk that takes longer than the scene. Lenses are exact up to the unit of the sensor, see `APERTURE`."""
    from pxr import Gf, UsdGeom

    for camera in cameras:
        prim = UsdGeom.Camera.Define(stage, f"{parent}/{camera.name}")
        world_from_cam = np.linalg.inv(camera.cam_from_world) @ OPENGL
        codes = camera.codes(last_code)
        _sample(prim.AddTransformOp(), codes, [Gf.Matrix4d(pose.T.tolist()) for pose in world_from_cam])  # rows times matrix
        lens = {name: [float(x) for x in values] for name, values in _lens(camera).items()}
        _sample(prim.GetFocalLengthAttr(), codes, lens["focal"])
        _sample(prim.GetHorizontalApertureAttr(), codes, [APERTURE] * len(codes))
        _sample(prim.GetVerticalApertureAttr(), codes, lens["high"])
        _sample(prim.GetHorizontalApertureOffsetAttr(), codes, lens["right"])
        _sample(prim.GetVerticalApertureOffsetAttr(), codes, lens["up"])
        prim.GetClippingRangeAttr().Set(Gf.Vec2f(camera.near, FAR * camera.near))
        if codes[-1] > last_code:
            stage.SetEndTimeCode(max(stage.GetEndTimeCode(), float(codes[-1])))


def _lens(camera: PosedCamera) -> dict[str, np.ndarray]:
    """[n] each, mm: focal length, height of the sensor, and how far its middle lies to the right of and above the axis of the lens."""
    fx, fy, cx, cy = (camera.K[:, row, column] for row, column in ((0, 0), (1, 1), (0, 2), (1, 2)))
    focal = APERTURE * fx / camera.width
    across, down = focal / fx, focal / fy  # mm a px
    return {
        "focal": focal,
        "high": down * camera.height,
        "right": across * (camera.width / 2 - cx),
        "up": down * (cy - camera.height / 2),
    }


def _sample(attribute: Any, codes: np.ndarray, values: Sequence[Any]) -> None:
    """Sets ``values`` at ``codes``; the first is also what readers see who ask for no time, and the only one if all are equal."""
    attribute.Set(values[0])
    if any(value != values[0] for value in values):
        for code, value in zip(codes, values, strict=True):
            attribute.Set(value, float(code))
