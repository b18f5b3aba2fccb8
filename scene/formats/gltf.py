"""Gaussians of one moment as a binary glTF file with KHR_gaussian_splatting (ratified by Khronos), which engines and web viewers read."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from ...rasterizer import Gaussians
from ..primitives import SH_C0
from .axes import Turn
from .glb import FLOAT, VERTICES, Glb
from .ply import seen

EXTENSION = "KHR_gaussian_splatting"
POINTS = 0  # a mode of glTF 2.0
NAME = "splats"


def glb_bytes(gaussians: Gaussians, turn: Turn | None = None) -> tuple[bytes, int]:
    """The file with the visible ones among ``gaussians`` (with sh), and their number. turn: the rotation of the node, which brings the
    capture's axes to those of glTF, where +Y is up.

    POSITION in world units and the capture's axes; ROTATION x y z w, unit; SCALE, standard deviations in world units; OPACITY in [0, 1];
    SH_DEGREE_l_COEF_n RGB, where n counts from the order -l upwards. COLOR_0 has colour, linear as in every glTF, and opacity for readers
    that only support points.
    """
    shown = seen(gaussians)
    assert shown.sh is not None
    sh, opacity, quats = shown.sh, shown.opacities.clamp(0, 1), shown.quats
    if not len(sh):  # an accessor of nothing is no valid glTF
        return Glb().bytes({"scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"name": NAME, **node_rotation(turn)}]}), 0
    displayed = torch.cat([0.5 + SH_C0 * sh[:, 0], opacity[:, None]], 1).detach().cpu().numpy()
    named: dict[str, Tensor] = {
        "POSITION": shown.means,
        "COLOR_0": torch.from_numpy(linear_colors(displayed)),
        f"{EXTENSION}:ROTATION": quats[:, [1, 2, 3, 0]],
        f"{EXTENSION}:SCALE": shown.scales,
        f"{EXTENSION}:OPACITY": opacity[:, None],
    }
    for k in range(sh.shape[1]):
        degree = int(k**0.5)
        named[f"{EXTENSION}:SH_DEGREE_{degree}_COEF_{k - degree * degree}"] = sh[:, k]
    file = Glb()
    attributes = {}
    for name, value in named.items():
        attributes[name] = file.add(value.detach().cpu().numpy().astype("<f4"), FLOAT, bounds=name == "POSITION", target=VERTICES)
    primitive = {
        "mode": POINTS,
        "attributes": attributes,
        "extensions": {EXTENSION: {"kernel": "ellipse", "colorSpace": "srgb_rec709_display", "projection": "perspective"}},
    }
    content = {
        "extensionsUsed": [EXTENSION],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"name": NAME, "mesh": 0, **node_rotation(turn)}],
        "meshes": [{"primitives": [primitive]}],
    }
    return file.bytes(content), len(sh)


def linear_colors(colors: np.ndarray) -> np.ndarray:
    """[V, 4] float64: RGB without the sRGB curve (IEC 61966-2-1), which colours of vertices in glTF do not have; opacity unchanged."""
    c = colors.clip(0, 1).astype(np.float64)
    rgb = np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)
    return np.concatenate([rgb[:, :3], c[:, 3:]], axis=1)


def node_rotation(turn: Turn | None) -> dict[str, list[float]]:
    """What a node says of ``turn``: its quaternion x y z w, or nothing if it does not turn."""
    return {"rotation": [float(c) for c in turn.quat[[1, 2, 3, 0]]]} if turn is not None and turn.turns else {}
