"""Triangle meshes with vertex colours: a PLY file of one moment, or a glTF file that plays through several."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .formats.axes import Turn
from .formats.glb import CORNERS, FLOAT, UNSIGNED_INT, UNSIGNED_SHORT, VERTICES, Glb
from .formats.gltf import linear_colors, node_rotation

TRIANGLES = 4  # a mode of glTF 2.0
UNLIT = "KHR_materials_unlit"  # the colours already contain the light of the capture


@dataclass
class Mesh:
    """vertices [V, 3] float32, world units. colors [V, 4] float32 in [0, 1], RGB as displayed (sRGB) and opacity. triangles [F, 3] int32,
    counter-clockwise seen from outside."""

    vertices: np.ndarray
    colors: np.ndarray
    triangles: np.ndarray

    @property
    def bytes_in_glb(self) -> int:
        """Bytes of its arrays in `mesh_glb_bytes`."""
        return 20 * len(self.vertices) + 12 * len(self.triangles)

    @classmethod
    def empty(cls) -> Mesh:
        return cls(np.zeros((0, 3), np.float32), np.zeros((0, 4), np.float32), np.zeros((0, 3), np.int32))


def mesh_ply_bytes(mesh: Mesh, turn: Turn | None = None) -> bytes:
    """Binary, little-endian: x y z float32, red green blue alpha uint8, and the list vertex_indices. turn: of the vertices."""
    vertex = np.zeros(len(mesh.vertices), [("place", "<f4", 3), ("colour", "u1", 4)])
    vertex["place"] = mesh.vertices if turn is None else mesh.vertices @ turn.matrix.T
    vertex["colour"] = (mesh.colors.clip(0, 1) * 255).round()
    face = np.zeros(len(mesh.triangles), [("count", "u1"), ("corners", "<i4", 3)])
    face["count"], face["corners"] = 3, mesh.triangles
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(vertex)}", *(f"property float {n}" for n in "xyz")]
    header += [f"property uchar {n}" for n in ("red", "green", "blue", "alpha")]
    header += [f"element face {len(face)}", "property list uchar int vertex_indices", "end_header"]
    return ("\n".join(header) + "\n").encode() + vertex.tobytes() + face.tobytes()


def mesh_glb_bytes(meshes: Sequence[Mesh], seconds: Sequence[float] = (0.0,), turn: Turn | None = None) -> bytes:
    """Binary glTF 2.0 with a node for each of ``meshes``. An animation shows one node at a time, each starting at its entry in ``seconds``
    (increasing). A viewer that ignores the animation shows the first. Hidden nodes have scale 0, which is how glTF hides nodes.
    turn: the rotation of their common parent, which brings the capture's axes to those of glTF, where +Y is up.

    Colours are linear, as glTF requires, and unlit; meshes with opacities below 1 are blended.
    """
    file = Glb()
    start = np.asarray(seconds, np.float64) - seconds[0]
    end = float(start[-1] + (start[-1] - start[-2] if len(start) > 1 else 0))  # the last is shown for as long as the one before
    nodes: list[dict[str, object]] = []
    shapes: list[dict[str, object]] = []
    channels: list[dict[str, object]] = []
    samplers: list[dict[str, object]] = []
    for k, mesh in enumerate(meshes):
        nodes.append({"name": f"frame{k + 1:04d}", "scale": [float(k == 0)] * 3})
        if len(mesh.triangles):
            nodes[k]["mesh"] = len(shapes)
            colors = (linear_colors(mesh.colors) * 65535).round().astype("<u2")
            attributes = {
                "POSITION": file.add(mesh.vertices.astype("<f4"), FLOAT, bounds=True, target=VERTICES),
                "COLOR_0": file.add(colors, UNSIGNED_SHORT, normalized=True, target=VERTICES),
            }
            material = int((mesh.colors[:, 3] < 1).any())
            corners = file.add(mesh.triangles.astype("<u4").reshape(-1, 1), UNSIGNED_INT, target=CORNERS)
            shapes.append({"primitives": [{"mode": TRIANGLES, "attributes": attributes, "indices": corners, "material": material}]})
        if len(meshes) > 1:
            keys = {
                0.0: float(k == 0),
                float(start[k]): 1.0,
                (float(start[k + 1]) if k + 1 < len(start) else end): float(k + 1 == len(start)),
            }
            key_times = file.add(np.array(list(keys), "<f4")[:, None], FLOAT, bounds=True)
            key_scales = file.add(np.repeat(np.array(list(keys.values()), "<f4")[:, None], 3, axis=1), FLOAT)
            channels.append({"sampler": k, "target": {"node": k, "path": "scale"}})
            samplers.append({"input": key_times, "output": key_scales, "interpolation": "STEP"})
    look = {"doubleSided": True, "extensions": {UNLIT: {}}, "pbrMetallicRoughness": {"metallicFactor": 0, "roughnessFactor": 1}}
    content: dict[str, object] = {
        "extensionsUsed": [UNLIT],
        "scene": 0,
        "scenes": [{"nodes": [len(nodes)]}],
        "nodes": [*nodes, {"name": "scene", "children": list(range(len(nodes))), **node_rotation(turn)}],
        "materials": [{"name": "solid", **look}, {"name": "translucent", "alphaMode": "BLEND", **look}],
    }
    if shapes:
        content["meshes"] = shapes
    if channels:
        content["animations"] = [{"name": "frames", "channels": channels, "samplers": samplers}]
    return file.bytes(content)
