"""What `hulls` chooses for a capture: the largest number of convexes. Imports nothing heavy."""

from __future__ import annotations

CONVEXES = 8000
VIEWS = 24  # training views in which edges are measured, spread evenly


def most_convexes(budget: int | None, nodes: bool) -> int:
    """The largest number of convexes: ``budget``, or `CONVEXES` if it is None, but none with control nodes, where they gain nothing."""
    if budget is not None:
        return budget
    return 0 if nodes else CONVEXES
