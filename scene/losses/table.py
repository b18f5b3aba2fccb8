"""The terms of the loss (Eq. 8 and 9, and the priors), in the order in which they are added. A new one is its file and a row here."""

from __future__ import annotations

from collections.abc import Callable

from .appearance import Appearance
from .depth_spread import DepthSpread
from .flow_terms import Interval, MeasuredFlowTerm
from .motion_priors import PlaneSmoothness, Rest, RigidAndSteady
from .opacity import Opacity
from .surface import Surface
from .term import Run, Term

# The first one compares images: its value tells whether training still improves.
TERMS: tuple[Callable[[Run], Term], ...] = (
    Appearance,
    DepthSpread,
    Surface,
    Opacity,
    Rest,
    PlaneSmoothness,
    RigidAndSteady,
    Interval,
    MeasuredFlowTerm,
)
