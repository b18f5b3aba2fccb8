"""Which axis of a scene points up, and the turn that makes it the one that a file format or a program expects."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from ...rasterizer import Gaussians

AXES = ("X", "-X", "Y", "-Y", "Z", "-Z")
OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])  # OpenCV's camera from one of OpenGL, USD and Blender: x right, y up, z back; and the other way
LEVEL = 1e-6  # of a unit vector: what is this near to an axis is that axis


def nearest_axis(up: np.ndarray) -> str:
    """Whichever of X, Y, Z, -X, -Y, -Z is nearest to ``up`` [3]."""
    k = int(np.abs(up).argmax())
    return ("" if up[k] > 0 else "-") + "XYZ"[k]


def unit_vector(axis: str) -> np.ndarray:
    """[3] float64 of one of `AXES`."""
    return (-1.0 if axis[0] == "-" else 1.0) * np.eye(3)["XYZ".index(axis[-1])]


@dataclass(frozen=True)
class Turn:
    """The quarter turn, half turn or none that brings axis ``before`` of the capture to axis ``after`` of a file; both are of `AXES`.

    A half turn is about X (of X itself, about Z), so that right stays right where Y and -Y change places.

    up: where up is no axis of the capture, its direction there. It is first brought to ``before`` by the smallest rotation that does it.
    """

    before: str
    after: str
    up: tuple[float, float, float] | None = None

    @classmethod
    def levelling(cls, up: np.ndarray, after: str) -> Turn:
        """The turn that brings the direction ``up`` [3] of a capture, whose axes have no meaning, to the axis ``after``."""
        before = nearest_axis(up)
        x, y, z = (float(part) for part in up / np.linalg.norm(up))
        leans = float(np.linalg.norm((x, y, z) - unit_vector(before))) > LEVEL
        return cls(before, after, (x, y, z) if leans else None)

    @property
    def about(self) -> np.ndarray:
        """[3] unit axis of the turn."""
        first, second = unit_vector(self.before), unit_vector(self.after)
        normal = np.cross(first, second)
        return normal if normal.any() else unit_vector("Z" if self.before[-1] == "X" else "X")

    @property
    def degrees(self) -> int:
        """0, 90 or 180, after levelling."""
        return {1: 0, 0: 90, -1: 180}[round(float(unit_vector(self.before) @ unit_vector(self.after)))]

    @property
    def turns(self) -> bool:
        """Whether anything changes."""
        return bool(self.degrees) or self.up is not None

    @property
    def level(self) -> np.ndarray:
        """[3, 3] float64: the smallest rotation that brings ``up`` to the axis ``before``; none without ``up``."""
        if self.up is None:
            return np.eye(3)
        first, second = np.array(self.up), unit_vector(self.before)
        x, y, z = np.cross(first, second)
        cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        return np.asarray(np.eye(3) + cross + cross @ cross / (1 + float(first @ second)))

    @property
    def matrix(self) -> np.ndarray:
        """[3, 3] float64, file from capture; without ``up`` every entry is 0, 1 or -1."""
        a, (x, y, z) = self.about, self.about
        cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        cosine, sine = {0: (1, 0), 90: (0, 1), 180: (-1, 0)}[self.degrees]
        quarters = np.asarray(cosine * np.eye(3) + sine * cross + (1 - cosine) * np.outer(a, a)) + 0.0
        return quarters if self.up is None else quarters @ self.level

    @property
    def quat(self) -> np.ndarray:
        """[4] float64, w x y z."""
        if self.up is not None:
            from scipy.spatial.transform import Rotation

            return np.asarray(Rotation.from_matrix(self.matrix).as_quat()[[3, 0, 1, 2]])
        half = {0: (1.0, 0.0), 90: (0.5**0.5, 0.5**0.5), 180: (0.0, 1.0)}[self.degrees]
        return np.concatenate([half[:1], half[1] * self.about]) + 0.0

    def __str__(self) -> str:
        if self.up is not None:
            lean = np.degrees(np.arccos(min(1.0, float(unit_vector(self.before) @ self.up))))
            where = ", ".join(f"{part:.3f}" for part in self.up)
            return f"up is {self.after}, which is ({where}) in the capture ({lean:.1f}° from {self.before}; --up capture leaves it so)"
        if not self.degrees:
            return f"up is {self.after}, and all axes are those of the capture"
        return f"up is {self.after}, which is {self.before} in the capture (a turn by {self.degrees}° about {nearest_axis(self.about)})"

    def __call__(self, gaussians: Gaussians) -> Gaussians:
        """``gaussians`` with positions, rotations and SH turned; the same object if there is nothing to turn."""
        return turned(gaussians, self.matrix) if self.turns else gaussians

    def back(self, gaussians: Gaussians) -> Gaussians:
        """``gaussians`` of a file in the axes of the capture; the same object if there is nothing to turn."""
        return turned(gaussians, self.matrix.T) if self.turns else gaussians


def turned(gaussians: Gaussians, rotation: np.ndarray) -> Gaussians:
    """``gaussians`` (with sh) turned about the origin by ``rotation`` [3, 3]: what a camera that turns with them sees is unchanged."""
    import torch
    from scipy.spatial.transform import Rotation

    from ..rotation import compose
    from .sh_rotation import rotated_sh

    assert gaussians.sh is not None
    x, y, z, w = Rotation.from_matrix(rotation).as_quat()
    quats = compose(gaussians.quats.new_tensor([[w, x, y, z]]).expand(len(gaussians.quats), 4), gaussians.quats)
    means = gaussians.means @ torch.as_tensor(rotation).to(gaussians.means).T
    return replace(gaussians, means=means, quats=quats, sh=rotated_sh(gaussians.sh, rotation))
