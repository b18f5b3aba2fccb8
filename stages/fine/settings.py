"""The settings of `fine`."""

from __future__ import annotations

from pydantic import Field

from ...scene.settings import RefinementSettings


class FineSettings(RefinementSettings):
    iterations: int | None = Field(
        None, ge=0, le=1_000_000, description="optimiser steps; by default 1500, but none for control nodes without convexes"
    )
    effort: float = Field(1.0, gt=0, le=100, description="factor on the number of steps that is chosen by default")
    lr_scale: float | None = Field(
        None, gt=0, le=1, description="factor on the first rates of what `coarse` trained; none: 0.1 along a path, else 0.3"
    )
