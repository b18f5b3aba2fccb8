"""Rotation of functions on the sphere that are given by real spherical harmonics, with the basis and signs of 3DGS."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from ...rasterizer.reference.sh import sh_basis
from ..fibonacci import fibonacci_sphere

DIRECTIONS = 64  # at which a rotated function is compared; 2 l + 1 suffice for degree l, more make the solution well conditioned


def rotated_sh(sh: Tensor, rotation: np.ndarray) -> Tensor:
    """Coefficients [N, C, 3] of the functions that have at ``rotation`` [3, 3] times d the values of those with coefficients ``sh`` at d.

    C is 1, 4, 9 or 16. Rotation does not mix degrees.
    """
    parts = [
        torch.einsum("jk,nkc->njc", one.to(sh), sh[:, degree**2 : (degree + 1) ** 2])
        for degree, one in enumerate(mixes(sh.shape[1], rotation))
    ]
    return torch.cat(parts, 1)


def mixes(coefficients: int, rotation: np.ndarray) -> list[Tensor]:
    """For degree l = 0, 1, ... the matrix [2 l + 1, 2 l + 1] float64 that takes coefficients of that degree to the rotated ones.

    The functions of one degree span a space that rotation maps to itself, so the matrix is the exact solution of B(R d) M = B(d) at enough
    directions d, where B are the values of the basis functions.
    """
    d = fibonacci_sphere(DIRECTIONS)
    before = sh_basis(torch.from_numpy(d), coefficients)
    after = sh_basis(torch.from_numpy(d @ np.asarray(rotation, np.float64).T), coefficients)
    found = []
    for degree in range(round(coefficients**0.5)):
        own = slice(degree**2, (degree + 1) ** 2)
        found.append(torch.linalg.lstsq(after[:, own], before[:, own]).solution)
    return found
