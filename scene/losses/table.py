"""The terms of the loss (Eq. 8 and 9, and the priors), in the order in which they are added. A new one is its own file and a row here."""

from .appearance import Appearance
from .depth_spread import DepthSpread
from .flow_terms import Interval, MeasuredFlowTerm
from .motion_priors import PlaneSmoothness, Rest, RigidAndSteady
from .moving_depth import MovingDepth
from .opacity import Opacity
from .surface import Surface
from .term import Term

TERMS: tuple[type[Term], ...] = (
    Appearance,  # the value of the first one tells whether training still improves
    DepthSpread,
    Surface,
    MovingDepth,
    Opacity,
    Rest,
    PlaneSmoothness,
    RigidAndSteady,
    Interval,
    MeasuredFlowTerm,
)
