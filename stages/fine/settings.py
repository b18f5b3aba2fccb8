"""The settings of `fine`."""

from __future__ import annotations

from pydantic import Field

from ...scene.settings import RefinementSettings


class FineSettings(RefinementSettings):
    iterations: int | None = Field(
        None, ge=0, le=1_000_000, description="optimiser steps; by default 1500, but none for control nodes without convexes"
    )
    effort: float = Field(1.0, gt=0, le=100, description="factor on the number of steps that is chosen by default")
    lr_scale: float = Field(0.3, gt=0, le=1, description="factor on the initial learning rates of what `coarse` has trained")
