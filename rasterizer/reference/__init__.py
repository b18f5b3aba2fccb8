"""The reference: the rasterizer's maths in plain float64 torch, differentiated by autograd. No tiles, no tricks, and slow."""

from .render import rasterize_reference

__all__ = ["rasterize_reference"]
