"""Which axis of a scene points up, and the turn that makes it the one that a file format or a program expects."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from ...rasterizer import Gaussians

AXES = ("X", "-X", "Y", "-Y", "Z", "-Z")


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
    """

    before: str
    after: str

    @property
    def about(self) -> np.ndarray:
        """[3] unit axis of the turn."""
        first, second = unit_vector(self.before), unit_vector(self.after)
        normal = np.cross(first, second)
        return normal if normal.any() else unit_vector("Z" if self.before[-1] == "X" else "X")

    @property
    def degrees(self) -> int:
        """0, 90 or 180."""
        return {1: 0, 0: 90, -1: 180}[round(float(unit_vector(self.before) @ unit_vector(self.after)))]

    @property
    def matrix(self) -> np.ndarray:
        """[3, 3] float64, file from capture; every entry is 0, 1 or -1."""
        a, (x, y, z) = self.about, self.about
        cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        cosine, sine = {0: (1, 0), 90: (0, 1), 180: (-1, 0)}[self.degrees]
        return np.asarray(cosine * np.eye(3) + sine * cross + (1 - cosine) * np.outer(a, a)) + 0.0

    @property
    def quat(self) -> np.ndarray:
        """[4] float64, w x y z."""
        half = {0: (1.0, 0.0), 90: (0.5**0.5, 0.5**0.5), 180: (0.0, 1.0)}[self.degrees]
        return np.concatenate([half[:1], half[1] * self.about]) + 0.0

    def __str__(self) -> str:
        if not self.degrees:
            return f"up is {self.after}, and all axes are those of the capture"
        return f"up is {self.after}, which is {self.before} in the capture (a turn by {self.degrees}° about {nearest_axis(self.about)})"

    def __call__(self, gaussians: Gaussians) -> Gaussians:
        """``gaussians`` with positions, rotations and SH turned; the same object if there is nothing to turn."""
        return turned(gaussians, self.matrix) if self.degrees else gaussians


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
