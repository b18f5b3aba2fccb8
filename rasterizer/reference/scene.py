"""All inputs of one call of `rasterize` as one object, whose tensors can be read and replaced by name."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import torch
from torch import Tensor

from ..rasterize import rasterize
from ..types import Camera, Convexes, Frame, Gaussians


@dataclass
class Scene:
    camera: Camera
    gaussians: Gaussians | None
    convexes: Convexes | None
    background: Tensor
    antialiased: bool = False
    tiles: Tensor | None = None

    def tensors(self) -> dict[str, Tensor]:
        """Every float input by name: K, cam_from_world, background, gaussians.means, ..., convexes.extras."""
        found = {"K": self.camera.K, "cam_from_world": self.camera.cam_from_world, "background": self.background}
        for kind in ("gaussians", "convexes"):
            owner = getattr(self, kind)
            if owner is not None:
                for field in fields(owner):
                    if getattr(owner, field.name) is not None:
                        found[f"{kind}.{field.name}"] = getattr(owner, field.name)
        return found

    def having(self, tensors: dict[str, Tensor]) -> Scene:
        """The same scene with the inputs in `tensors` replaced."""
        parts: dict[str, Any] = {"camera": self.camera, "gaussians": self.gaussians, "convexes": self.convexes}
        background = tensors.get("background", self.background)
        for name, value in tensors.items():
            if name in ("K", "cam_from_world"):
                parts["camera"] = replace(parts["camera"], **{name: value})
            elif name != "background":
                kind, field = name.split(".")
                parts[kind] = replace(parts[kind], **{field: value})
        return Scene(background=background, antialiased=self.antialiased, tiles=self.tiles, **parts)

    def to(self, dtype: torch.dtype) -> Scene:
        return self.having({name: value.to(dtype) for name, value in self.tensors().items()})

    def leaves(self) -> dict[str, Tensor]:
        """Detached copies of all inputs, with requires_grad set."""
        return {name: value.detach().clone().requires_grad_() for name, value in self.tensors().items()}

    def primitive_leaves(self) -> dict[str, Tensor]:
        """Like `leaves`, but without camera and background: the inputs for which training needs gradients."""
        return {name: leaf for name, leaf in self.leaves().items() if "." in name}

    def render(self, backend: str = "reference", **options: Any) -> Frame:
        options = {"antialiased": self.antialiased, "tiles": self.tiles} | options
        return rasterize(self.camera, self.gaussians, self.convexes, self.background, backend=backend, **options)  # type: ignore[arg-type]
