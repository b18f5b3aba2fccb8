"""The settings of `coarse`."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from ...scene.settings import Strategy, TrainingSettings


class CoarseSettings(TrainingSettings):
    iterations: int = Field(0, ge=0, le=1_000_000, description="optimiser steps of this stage; 0: chosen for the capture")
    effort: float = Field(1.0, gt=0, le=100, description="factor on the number of steps that is chosen for the capture")
    motion: Literal["auto", "planes", "nodes", "free"] = Field(
        "auto",
        description="what moves primitives: planes, the six-plane field; nodes, control nodes (auto: if each frame is seen from another "
        "side); free, each primitive moves and lives for a time of its own (auto: if masks show what moves)",
    )
    strategy: Strategy = Field("two-stage", description="training strategy, one of the four of Table 3; `fine` uses the same")
    antialiased: bool = Field(
        True,
        description="train and draw in the antialiased mode, which is right at other image sizes and distances, too",
    )
    full_from: float = Field(0.5, ge=0, le=1, description="fraction of the steps that use images of half the size, before the full size")
    seeds: int = Field(
        0, ge=0, le=2_000_000, description="initial number of Gaussians; 0: half the budget for rigs and one camera on its path, else 8000"
    )
