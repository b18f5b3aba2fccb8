"""The settings of `coarse`."""

from __future__ import annotations

from typing import ClassVar

from pydantic import Field

from ...scene.settings import MotionSettings, Strategy, TrainingSettings


class CoarseSettings(MotionSettings, TrainingSettings):
    renamed: ClassVar = {"seeds": "seeds.count"}
    respelled: ClassVar = {"iterations": {"0": None}}

    iterations: int | None = Field(None, ge=1, le=1_000_000, description="optimiser steps of this stage; none: chosen for the capture")
    effort: float = Field(1.0, gt=0, le=100, description="factor on the steps that a capture gets; few views cap them")
    strategy: Strategy = Field("two-stage", description="training strategy, one of the four of Table 3; `fine` uses the same")
    antialiased: bool = Field(
        True,
        description="train and draw in the antialiased mode, which is right at other image sizes and distances, too",
    )
    full_from: float = Field(0.5, ge=0, le=1, description="fraction of the steps that use images of half the size, before the full size")
