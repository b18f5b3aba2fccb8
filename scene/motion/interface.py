"""The seam between primitives and whatever moves them: what rests somewhere goes in with a time, and comes out where it is then."""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np
from torch import Tensor

from ..primitives import Life


class Displacement(NamedTuple):
    """What one time does to N rest positions.

    dx: [N, 3] world units, added to the position. dr: [N, 4] unit quaternion (w x y z) that turns the primitive further.
    ds: [N, 3] added to the logarithm of the scales.
    """

    dx: Tensor
    dr: Tensor
    ds: Tensor


class Rest(NamedTuple):
    """What a motion carries: the centres of M Gaussians and, behind them, corners of convexes.

    points: [N, 3] world units. quats: [M, 4] of the Gaussians, w x y z, any norm. hyper: [N, 2] coordinates beside x, y, z in which parts
    that touch may lie apart. link: [N, k] int32, see `Motion.links`. life: of the N points, each as the primitive that it belongs to.
    centres: [N, 3] world units, what each turns about; None where all are centres.
    """

    points: Tensor
    quats: Tensor
    hyper: Tensor
    link: Tensor | None
    life: Life | None = None
    centres: Tensor | None = None


class Moved(NamedTuple):
    """Where `Rest` is at a time: points [N, 3], quats [M, 4], what the logarithms of the Gaussians' scales gain [M, 3], or None, and how
    much of its opacity each point has then, [N] in [0, 1], or None for all of it."""

    points: Tensor
    quats: Tensor
    log_scales: Tensor | None
    presence: Tensor | None = None


class Motion(Protocol):
    """A motion model: the six-plane field, or control nodes."""

    worth_culling: bool  # positions outside of the image are better left out
    steady: bool  # by construction: nothing changes course, and no prior says how

    def carry(self, rest: Rest, t: float) -> Moved:
        """``rest`` at time ``t`` in [0, 1]. Positions get gradients by how they are carried, not by where they are looked up."""
        ...

    def links(self, points: Tensor, hyper: Tensor) -> Tensor | None:
        """[N, k] int32: which parts of the motion carry each of ``points`` [N, 3] with ``hyper`` [N, 2]; None where all of it does. It is
        kept over some steps, since it takes a search."""
        ...

    def spread_over(self, points: np.ndarray) -> Motion | None:
        """The same motion with its parts spread anew over ``points`` [P, 3]; None where it has no such parts."""
        ...

    def priors(self, rest: Tensor, neighbours: Tensor, t: float, dt: float) -> tuple[Tensor, Tensor]:
        """How far the motion at ``t`` is from rigid, judged by ``rest`` and ``neighbours`` [n, 3] a little beside them, and how much it
        changes over two steps of ``dt``: two scalars of order one."""
        ...

    def regulariser(self) -> Tensor:
        """Scalar, lambda_3's term in Eq. 9."""
        ...
