"""Gaussians of one moment as a binary glTF file with KHR_gaussian_splatting (ratified by Khronos), which engines and web viewers read."""

from __future__ import annotations

import json
import struct

import numpy as np
import torch
from torch import Tensor

from ..rasterizer import Gaussians
from .ply import seen_rows

EXTENSION = "KHR_gaussian_splatting"
FLOAT, POINTS, ARRAY_BUFFER = 5126, 0, 34962  # of glTF 2.0
JSON_CHUNK, BINARY_CHUNK = 0x4E4F534A, 0x004E4942
SH_0 = 0.28209479177387814  # the constant spherical harmonic


def glb_bytes(gaussians: Gaussians) -> tuple[bytes, int]:
    """The file of those of ``gaussians`` (with sh) that can be seen, and how many these are.

    POSITION in world units and the capture's axes; ROTATION x y z w, unit; SCALE, standard deviations in world units; OPACITY in [0, 1];
    SH_DEGREE_l_COEF_n RGB, n from the order -l upwards. COLOR_0 holds colour and opacity for readers that know points alone.
    """
    assert gaussians.sh is not None
    keep = seen_rows(gaussians)
    sh, opacity = gaussians.sh[keep], gaussians.opacities[keep].clamp(0, 1)
    quats = torch.nn.functional.normalize(gaussians.quats[keep], dim=1)
    named: dict[str, Tensor] = {
        "POSITION": gaussians.means[keep],
        "COLOR_0": torch.cat([(0.5 + SH_0 * sh[:, 0]).clamp(0, 1), opacity[:, None]], 1),
        f"{EXTENSION}:ROTATION": quats[:, [1, 2, 3, 0]],
        f"{EXTENSION}:SCALE": gaussians.scales[keep],
        f"{EXTENSION}:OPACITY": opacity[:, None],
    }
    for k in range(sh.shape[1]):
        degree = int(k**0.5)
        named[f"{EXTENSION}:SH_DEGREE_{degree}_COEF_{k - degree * degree}"] = sh[:, k]
    accessors: list[dict[str, object]] = []
    views: list[dict[str, int]] = []
    parts: list[bytes] = []
    offset = 0
    for name, value in named.items():
        array = np.ascontiguousarray(value.detach().cpu().numpy(), "<f4")
        kind = "SCALAR" if array.shape[1] == 1 else f"VEC{array.shape[1]}"
        accessor: dict[str, object] = {"bufferView": len(views), "componentType": FLOAT, "count": len(array), "type": kind}
        if name == "POSITION" and len(array):
            accessor |= {"min": array.min(0).tolist(), "max": array.max(0).tolist()}
        accessors.append(accessor)
        views.append({"buffer": 0, "byteOffset": offset, "byteLength": array.nbytes, "target": ARRAY_BUFFER})
        parts.append(array.tobytes())
        offset += array.nbytes
    primitive = {
        "mode": POINTS,
        "attributes": {name: k for k, name in enumerate(named)},
        "extensions": {EXTENSION: {"kernel": "ellipse", "colorSpace": "srgb_rec709_display", "projection": "perspective"}},
    }
    content = {
        "asset": {"version": "2.0", "generator": "e4dgs"},
        "extensionsUsed": [EXTENSION],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [primitive]}],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": offset}],
    }
    text = json.dumps(content, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    binary = b"".join(parts)  # of float32, so its length is a multiple of four
    chunks = struct.pack("<II", len(text), JSON_CHUNK) + text + struct.pack("<II", len(binary), BINARY_CHUNK) + binary
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks, int(keep.sum())
