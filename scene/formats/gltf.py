"""Gaussians of one moment as a binary glTF file with KHR_gaussian_splatting (ratified by Khronos), which engines and web viewers read."""

from __future__ import annotations

import torch
from torch import Tensor

from ...rasterizer import Gaussians
from ..primitives import SH_C0
from .axes import Turn
from .glb import FLOAT, VERTICES, Glb
from .ply import seen

EXTENSION = "KHR_gaussian_splatting"
POINTS = 0  # a mode of glTF 2.0


def glb_bytes(gaussians: Gaussians, turn: Turn | None = None) -> tuple[bytes, int]:
    """The file with the visible ones among ``gaussians`` (with sh), and their number. turn: the rotation of the node, which brings the
    capture's axes to those of glTF, where +Y is up.

    POSITION in world units and the capture's axes; ROTATION x y z w, unit; SCALE, standard deviations in world units; OPACITY in [0, 1];
    SH_DEGREE_l_COEF_n RGB, where n counts from the order -l upwards. COLOR_0 has colour and opacity for readers that only support points.
    """
    shown = seen(gaussians)
    assert shown.sh is not None
    sh, opacity, quats = shown.sh, shown.opacities.clamp(0, 1), shown.quats
    named: dict[str, Tensor] = {
        "POSITION": shown.means,
        "COLOR_0": torch.cat([(0.5 + SH_C0 * sh[:, 0]).clamp(0, 1), opacity[:, None]], 1),
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
        "nodes": [{"name": "splats", "mesh": 0, **node_rotation(turn)}],
        "meshes": [{"primitives": [primitive]}],
    }
    return file.bytes(content), len(sh)


def node_rotation(turn: Turn | None) -> dict[str, list[float]]:
    """What a node says of ``turn``: its quaternion x y z w, or nothing if it does not turn."""
    return {"rotation": [float(c) for c in turn.quat[[1, 2, 3, 0]]]} if turn is not None and turn.degrees else {}
