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
    """A motion model. The six-plane field is one; nodes that drive their nearest primitives can be another."""

    def __call__(self, rest: Tensor, t: float) -> Displacement:
        """Displacement of ``rest`` [N, 3] (world units; enters detached) at time ``t`` in [0, 1]."""
        ...

    def rigid_motion(self, rest: Tensor, t: float) -> Tensor:
        """[N, 7] numbers of order one that are equal for positions that move as one rigid body."""
        ...

    def regulariser(self) -> Tensor:
        """Scalar, lambda_3's term in Eq. 9."""
        ...
