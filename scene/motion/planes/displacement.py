"""What the six-plane field does to rest positions at one time."""

from __future__ import annotations

from typing import NamedTuple

from torch import Tensor


class Displacement(NamedTuple):
    """The change of N rest positions at one time.

    dx: [N, 3] world units, added to the position. dr: [N, 4] unit quaternion (w x y z) that turns the primitive further.
    ds: [N, 3] added to the logarithm of the scales.
    """

    dx: Tensor
    dr: Tensor
    ds: Tensor
