"""Control nodes at one time, as primitives are skinned to them."""

from __future__ import annotations

from typing import NamedTuple

from torch import Tensor


class Nodes(NamedTuple):
    """B nodes at one time: home [B, 3] at rest, home_hyper [B, H], falloff [B] = 1 / (2 radius^2) > 0, turns [B, 4] unit quaternions
    (w x y z) about the node's own rest position, shifts [B, 3]. Lengths in world units."""

    home: Tensor
    home_hyper: Tensor
    falloff: Tensor
    turns: Tensor
    shifts: Tensor
