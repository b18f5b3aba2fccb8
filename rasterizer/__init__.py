"""Differentiable rendering of primitives: 3D Gaussians and smooth convexes, blended in one pass. See DESIGN.md."""

from .rasterize import rasterize
from .types import TILE, Camera, Convexes, Frame, Gaussians

__all__ = ["TILE", "Camera", "Convexes", "Frame", "Gaussians", "rasterize"]
