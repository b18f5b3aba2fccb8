"""The seam between primitives and whatever moves them: rest positions and a time in, displacements out."""

from __future__ import annotations

from typing import NamedTuple, Protocol

from torch import Tensor


class Displacement(NamedTuple):
    """What one time does to N rest positions.

    dx: [N, 3] world units, added to the position. dr: [N, 4] unit quaternion (w x y z) that turns the primitive further.
    ds: [N, 3] added to the logarithm of the scales.
    """

    dx: Tensor
    dr: Tensor
    ds: Tensor


class Motion(Protocol):
    """A motion model: the six-plane field, or nodes that drive their nearest primitives."""

    def __call__(self, rest: Tensor, t: float) -> Displacement:
        """Displacement of ``rest`` [N, 3] (world units; enters detached) at time ``t`` in [0, 1]."""
        ...

    def priors(self, rest: Tensor, neighbours: Tensor, t: float, dt: float) -> tuple[Tensor, Tensor]:
        """How far the motion at ``t`` is from rigid, judged by ``rest`` and ``neighbours`` [n, 3] a little beside them, and how much it
        changes over two steps of ``dt``: two scalars of order one."""
        ...

    def regulariser(self) -> Tensor:
        """Scalar, lambda_3's term in Eq. 9."""
        ...

    def extend(self, low: float, high: float) -> None:
        """Training is about to see the times from ``low`` to ``high``."""
        ...
