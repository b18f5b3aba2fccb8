"""What `hulls` chooses for a capture: the largest number of convexes. Imports nothing heavy."""

from __future__ import annotations

from ...scene.motion.kinds import KINDS

CONVEXES = 8000
VIEWS = 24  # training views in which edges are measured, spread evenly


def most_convexes(budget: int | None, kind: str) -> int:
    """The largest number of convexes: ``budget``, or `CONVEXES` if it is None, but none with a ``kind`` of motion with which they gain
    nothing."""
    if budget is not None:
        return budget
    return CONVEXES if KINDS[kind].convexes else 0
