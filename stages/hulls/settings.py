"""The settings of `hulls`."""

from __future__ import annotations

from pydantic import Field

from ...pipeline import Settings


class HullSettings(Settings):
    k: int = Field(6, ge=3, le=8, description="number of points of a convex")
    budget: int | None = Field(
        None, ge=0, le=200_000, description="most convexes; 0: none. By default 8000, but none with control nodes, where they gain nothing"
    )
    share: float = Field(0.2, ge=0, le=1, description="largest share of the Gaussians that become convexes")
    min_edge_density: float = Field(0.25, ge=0, le=1, description="least mean edge weight under a Gaussian that becomes a convex")
