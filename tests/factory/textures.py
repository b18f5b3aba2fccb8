"""Procedural textures on surface coordinates: hard edges everywhere, so that features and edge metrics have something to find."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Colour = tuple[float, float, float]


@dataclass(frozen=True)
class Checker:
    """Squares of side `cell` in two colours; every face has its own tint, so that the faces of a box can be told apart."""

    cell: float
    light: Colour = (0.92, 0.90, 0.84)
    dark: Colour = (0.16, 0.22, 0.34)
    tint: float = 0.35
    shift: float = 0.0  # of the lattice, in cells

    def __call__(self, uv: Array, face: NDArray[np.int64]) -> Array:
        parity = np.floor(uv / self.cell + self.shift).astype(np.int64).sum(axis=-1) & 1
        base = np.where(parity[:, None] == 0, np.asarray(self.light), np.asarray(self.dark))
        tints = np.array([[1.0, 0.55, 0.45], [0.5, 0.85, 1.0], [1.0, 0.85, 0.4], [0.55, 1.0, 0.6], [0.8, 0.6, 1.0], [1.0, 1.0, 1.0]])
        return base * (1.0 - self.tint + self.tint * tints[face % 6])


@dataclass(frozen=True)
class Stripes:
    """Bands of width `width` along the second coordinate, in turn in the given colours."""

    width: float
    colours: tuple[Colour, ...] = ((0.90, 0.24, 0.16), (0.96, 0.93, 0.86))

    def __call__(self, uv: Array, face: NDArray[np.int64]) -> Array:
        index = np.floor(uv[:, 1] / self.width + 0.5).astype(np.int64) % len(self.colours)
        return np.asarray(self.colours)[index]


@dataclass(frozen=True)
class Cells:
    """Random colours on three rotated lattices of decreasing size: corners and blobs at several scales, unlike anywhere else.

    SIFT finds and matches plenty of these, which checkers (alike everywhere) do not allow.
    """

    cell: float
    seed: int = 0

    def __call__(self, uv: Array, face: NDArray[np.int64]) -> Array:
        total = np.zeros((len(uv), 3))
        for octave, (shrink, weight, angle) in enumerate([(1.0, 0.45, 0.3), (0.41, 0.33, 1.1), (0.19, 0.22, 1.9)]):
            c, s = np.cos(angle), np.sin(angle)
            lattice = np.floor(uv @ np.array([[c, s], [-s, c]]) / (self.cell * shrink)).astype(np.int64)
            total += weight * _hash_colours(lattice[:, 0], lattice[:, 1], face, self.seed * 8 + octave)
        grey = total.mean(axis=-1, keepdims=True)
        return np.clip(0.5 + 2.0 * (grey - 0.5) + 0.7 * (total - grey), 0.03, 0.97)


Texture = Checker | Stripes | Cells


def _hash_colours(a: NDArray[np.int64], b: NDArray[np.int64], c: NDArray[np.int64], seed: int) -> Array:
    """Integer triples to colours [N,3] in [0,1): the 64-bit finaliser of MurmurHash3 over a linear mix."""
    mix = np.uint64(0x9E3779B97F4A7C15)
    x = a.astype(np.uint64) * np.uint64(0xD1342543DE82EF95) + b.astype(np.uint64) * np.uint64(0xAF251AF3B0F025B5)
    x += c.astype(np.uint64) * mix + np.uint64((seed * 0x2545F4914F6CDD1D + 1) & 0xFFFFFFFFFFFFFFFF)
    for factor in (0xFF51AFD7ED558CCD, 0xC4CEB9FE1A85EC53):
        x ^= x >> np.uint64(33)
        x *= np.uint64(factor)
    x ^= x >> np.uint64(33)
    channels = [(x >> np.uint64(shift)) & np.uint64(0xFFFF) for shift in (0, 16, 32)]
    return np.stack(channels, axis=-1).astype(np.float64) / 65536.0
