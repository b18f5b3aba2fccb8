"""A scene as the web player shows it, in Python: written as bytes, read back, evaluated at a time, rendered."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ....rasterizer import Camera, Convexes, Frame, Gaussians, rasterize
from ...primitives import SH_C0
from ...rotation import compose
from .arrays import decode, encode
from .container import pack, unpack
from .layout import check_header, shapes_of
from .moved import lived, on_nodes, on_paths

DELTAS = ("g_means", "g_links", "node_courses", "light", "g_path_means", "g_path_turns", "g_path_scales", "c_path_points")


@dataclass
class WebScene:
    """header: see `layout.check_header` and docs/player.md. arrays: float64 [n, m, c] by name, with the shapes of `layout.shapes_of`."""

    header: dict[str, Any]
    arrays: dict[str, np.ndarray]

    def to_bytes(self, steps: Mapping[str, float | np.ndarray] | None = None) -> bytes:
        """The file. ``steps``: of each array, in its unit; without them all numbers stay float32, except for the links of nodes."""
        kept = {name: 1.0 for name in self.arrays if name.endswith("_links")} | dict(steps or {})
        coded = [encode(name, self.arrays[name], kept.get(name), name in DELTAS and name in kept) for name in shapes_of(self.header)]
        return pack(self.header, coded)

    @classmethod
    def from_bytes(cls, data: bytes) -> WebScene:
        """Reads a file. Raises ValueError that says what is wrong with it."""
        header, coded = unpack(data)
        check_header(header)
        wanted, given = shapes_of(header), {name: one.shape for name, one in coded.items()}
        for name in wanted.keys() | given.keys():
            if wanted.get(name) != given.get(name):
                raise ValueError(f"its array {name} has the shape {given.get(name)}, expected {wanted.get(name)}")
        arrays = {name: decode(one) for name, one in coded.items()}
        for name in ("g_links", "c_links"):
            if name in arrays and arrays[name].size and not (arrays[name].min() >= 0 and arrays[name].max() < header["nodes"]):
                raise ValueError(f"its array {name} names a node that is not there")
        return cls(header, arrays)

    def at(self, t: float) -> tuple[Gaussians, Convexes]:
        """Both kinds at time ``t`` in [0, 1], ready for `rasterize`: static ones first."""
        t = min(max(float(t), 0.0), 1.0)
        motion, corners = self.header["motion"], self.header["corners"]
        still, bent = self.header["gaussians"][0], self.header["convexes"][0]
        means, scales, points = self._rows("g_means"), self._rows("g_scales"), self._array("c_points")
        turns = unit_from_three(self._rows("g_turns"))
        opacities, solid = self._rows("g_opacity")[:, 0], self._rows("c_opacity")[:, 0]
        if motion == "lives":
            frame = t * (self.header["frames"] - 1)
            means[still:], turned, opacities[still:] = lived(self, "g", frame, means[still:, None], turns[still:], opacities[still:])
            assert turned is not None  # `None` is for convexes
            turns[still:] = turned
            points[bent:], _, solid[bent:] = lived(self, "c", frame, points[bent:], None, solid[bent:])
        elif motion == "nodes":
            means[still:], turned = on_nodes(self, "g", t, means[still:], turns[still:])
            assert turned is not None
            turns[still:] = turned
            moved, _ = on_nodes(self, "c", t, points[bent:].reshape(-1, 3), None)
            points[bent:] = moved.reshape(-1, corners, 3)
        elif motion == "paths":
            shift, turn, growth = (on_paths(self, f"g_path_{name}", t) for name in ("means", "turns", "scales"))
            means[still:] += shift
            turns[still:] = compose(turn / turn.norm(dim=1, keepdim=True).clamp(min=1e-6), turns[still:])
            scales[still:] += growth
            points[bent:] += on_paths(self, "c_path_points", t).reshape(-1, corners, 3)
        shape = self._rows("c_shape").exp()
        return (
            Gaussians(means, turns, scales.exp(), opacities.clamp(0, 1), sh=self._sh("g", t)),
            Convexes(points, shape[:, 0].contiguous(), shape[:, 1].contiguous(), solid.clamp(0, 1), sh=self._sh("c", t)),
        )

    def render(self, camera: Camera, time: float) -> Frame:
        """One view at ``time`` in [0, 1], as `Model.render`."""
        camera = replace(camera, near=max(camera.near, self.header["near"]))
        background = torch.tensor(self.header["background"]).float()
        return rasterize(camera, *self.at(time), background, antialiased=self.header["antialiased"])

    def _array(self, name: str) -> Tensor:
        return torch.tensor(self.arrays[name], dtype=torch.float32)

    def _rows(self, name: str) -> Tensor:
        """[n, c] of an array with m = 1."""
        return self._array(name)[:, 0].contiguous()

    def _sh(self, kind: str, t: float) -> Tensor:
        dc = self._rows(f"{kind}_color")[:, None]
        if self.header["light"]:
            gain = (self._rows(f"{kind}_shades") * on_paths(self, "light", t)).sum(1)
            dc = dc + gain[:, None, None] * (dc + 0.5 / SH_C0)
        rest = [self._rows(f"{kind}_sh{d}").reshape(-1, 2 * d + 1, 3) for d in range(1, self.header["sh_degree"] + 1)]
        return torch.cat([dc, *rest], 1)


def unit_from_three(three: Tensor) -> Tensor:
    """Unit quaternions [n, 4] w x y z from x y z [n, 3], with w >= 0."""
    w = (1 - three.square().sum(1, keepdim=True)).clamp(min=0).sqrt()
    return torch.cat([w, three], 1)
