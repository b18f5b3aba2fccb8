"""When a primitive is present, and how it moves during that time: what primitives carry for `Lifetimes`."""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from ...primitives import Attribute, PrimitiveSet

ALWAYS = 1e4  # frames; a primitive with so long a lifetime is present throughout


class Lifetime(NamedTuple):
    """Of N primitives. ``times`` [N]: the temporal centres, in frames. ``log_spans`` [N]: the logarithms of the standard deviations of
    their presence in frames. ``velocities`` [N, 3]: world units a frame. ``spins`` [N, 3]: angular velocities, rotation vectors in radians
    a frame. Frames are the times of the capture, counted from 0."""

    times: Tensor
    log_spans: Tensor
    velocities: Tensor
    spins: Tensor


ATTRIBUTES = {"times": Attribute(), "log_spans": Attribute((), math.log(ALWAYS)), "velocities": Attribute((3,)), "spins": Attribute((3,))}


def lifetime(primitives: PrimitiveSet) -> Lifetime:
    """The lifetimes that ``primitives`` carry."""
    return Lifetime(*(primitives.parameters[name] for name in Lifetime._fields))


@torch.no_grad()
def set_lifetime(primitives: PrimitiveSet, time: float | Tensor, span: float, velocities: Tensor | None = None) -> None:
    """Centre the lifetimes of all rows on frame ``time`` (a number or [N]), with a standard deviation of ``span`` frames and, if given,
    ``velocities`` [N, 3]. The ``primitives`` carry `ATTRIBUTES` from now on."""
    primitives.parameters = primitives.carrying(ATTRIBUTES).parameters
    primitives.times[:] = time
    primitives.log_spans.fill_(math.log(span))
    if velocities is not None:
        primitives.velocities.copy_(velocities)
