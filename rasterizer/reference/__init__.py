"""The oracle: the maths of the rasterizer in plain float64 torch, differentiated by autograd. No tiles, no tricks, no speed."""

from .render import rasterize_reference

__all__ = ["rasterize_reference"]
