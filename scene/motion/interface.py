"""The interface between primitives and the model that moves them: rest positions and a time in, positions at that time out."""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np
import torch
from torch import Tensor

Time = float | Tensor  # a moment in [0, 1]; a tensor [] on the device while a CUDA graph is captured, which is replayed for other moments


TOLERANCE = 1e-6  # beyond 0 and 1 that a time may lie, as sums of steps do


def check_time(t: Time) -> None:
    """Raises ValueError if ``t`` is a number outside [0, 1], or none. A tensor is not looked at: the host would wait for the device."""
    if not isinstance(t, Tensor) and not -TOLERANCE <= t <= 1 + TOLERANCE:
        raise ValueError(f"time {t:g}: a model has times from 0 (first of the capture) to 1 (last)")


def together(times: list[Time]) -> list[float] | Tensor:
    """``times``, all floats or all tensors, as one tensor [T] if they are tensors."""
    tensors = [t for t in times if isinstance(t, Tensor)]
    return torch.stack(tensors) if tensors else [float(t) for t in times]


class Displacement(NamedTuple):
    """The change of N rest positions at one time.

    dx: [N, 3] world units, added to the position. dr: [N, 4] unit quaternion (w x y z) that turns the primitive further.
    ds: [N, 3] added to the logarithm of the scales.
    """

    dx: Tensor
    dr: Tensor
    ds: Tensor


class Rest(NamedTuple):
    """What a motion carries: the centres of M Gaussians, followed by corners of convexes.

    points: [N, 3] world units. quats: [M, 4] of the Gaussians, w x y z, any norm. hyper: [N, 2] coordinates in addition to x, y, z, in
    which parts that touch can be apart. link: [N, k] int32, see `Motion.links`.
    """

    points: Tensor
    quats: Tensor
    hyper: Tensor
    link: Tensor | None


class Moved(NamedTuple):
    """`Rest` at one time: points [N, 3]; quats [M, 4]; log_scales [M, 3], added to the logarithms of the Gaussians' scales, or None."""

    points: Tensor
    quats: Tensor
    log_scales: Tensor | None


class Motion(Protocol):
    """A motion model: the six-plane field, control nodes, or free primitives. The first two are a `Carrier`, too."""

    worth_culling: bool  # whether leaving out positions outside the image saves time
    steady: bool  # motion is steady by construction, so that the priors do not apply
    priors_at_places: bool  # whether `priors` looks at the places that it is given

    def links(self, points: Tensor, hyper: Tensor) -> Tensor | None:
        """[N, k] int32: which parts of the motion carry each of ``points`` [N, 3] with ``hyper`` [N, 2]; None if it has no parts. This
        takes a search, so callers keep the result for some steps."""
        ...

    def spread_over(self, points: np.ndarray) -> Motion | None:
        """The same motion with its parts spread again over ``points`` [P, 3]; None if it has no such parts."""
        ...

    def priors(self, rest: Tensor, neighbours: Tensor, t: Time, dt: float) -> tuple[Tensor, Tensor]:
        """How far the motion at ``t`` is from rigid, judged by ``rest`` [n, 3] and nearby ``neighbours`` [n, 3], and how much it changes
        over two steps of ``dt``: two scalars of order one."""
        ...

    def light(self, t: Time) -> Tensor | None:
        """How bright the scene's light is at ``t``: [SHADES] courses of light, which each primitive follows by its own `shades`; None if
        colours do not change over time."""
        ...

    def pace(self, log_spans: Tensor) -> Tensor | None:
        """A factor [m] on the learning rates of primitives with these ``log_spans`` [m], see `Life`; None if lives play no part."""
        ...

    def regulariser(self) -> Tensor:
        """The term of lambda_3 in Eq. 9, a scalar."""
        ...


class Carrier(Motion, Protocol):
    """A motion that is defined at places, so that it carries whatever is there."""

    def carry(self, rest: Rest, t: Time) -> Moved:
        """``rest`` at time ``t`` in [0, 1]. Positions get gradients through the transform that moves them, not through the look-up."""
        ...
