"""The convex hull of a few points in the plane by Graham's scan (Andrew's variant: points sorted by x, then y)."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

Point = tuple[float, float]

FLAT = 1e-12  # relative to the squared extent; a turn up to this size may be a rounding error


def hull_corners(points: Sequence[Point]) -> list[int]:
    """Indices of the corners, in the order in which the shoelace sum is positive.

    Only extreme points are corners: a point on an edge is not, and only one of several coincident points is. The hull of points on
    a line is its two ends; the hull of coincident points is one point. Whether a point lies on an edge is judged with the tolerance
    FLAT. Otherwise rounding would decide whether such a point gets the gradients of two edges or none.
    """
    order = sorted(range(len(points)), key=lambda i: points[i])
    distinct = [i for n, i in enumerate(order) if n == 0 or points[i] != points[order[n - 1]]]
    if len(distinct) < 3:
        return distinct
    flat = FLAT * extent(points) ** 2
    return _chain(points, distinct, flat)[:-1] + _chain(points, distinct[::-1], flat)[:-1]


def _chain(points: Sequence[Point], order: list[int], flat: float) -> list[int]:
    """One side of the hull: walk along the sorted points and drop every point at which the path does not make a positive turn."""
    kept: list[int] = []
    for i in order:
        while len(kept) > 1 and turn(points[kept[-2]], points[kept[-1]], points[i]) <= flat:
            kept.pop()
        kept.append(i)
    return kept


def turn(a: Point, b: Point, c: Point) -> float:
    """Twice the signed area of the triangle a b c."""
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


def extent(points: Sequence[Point]) -> float:
    """The longer side of the bounding box."""
    return max(max(p[axis] for p in points) - min(p[axis] for p in points) for axis in (0, 1))


def hull_area(points: Sequence[Point], corners: Sequence[int]) -> float:
    """Area of the polygon with these corners. The sum is taken relative to its first corner, so it is accurate far from the origin too."""
    first = points[corners[0]]
    return 0.5 * sum(turn(first, points[b], points[c]) for b, c in pairwise(corners))
