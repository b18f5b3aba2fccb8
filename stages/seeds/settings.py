"""The settings of `seeds`. Those of the group `train` are the same for the stages that train on the seeds."""

from typing import ClassVar

from pydantic import Field

from ...scene.settings import BudgetSettings, MotionSettings, RandomSettings


class SeedsSettings(MotionSettings, BudgetSettings, RandomSettings):
    respelled: ClassVar = {"count": {"0": None}}

    count: int | None = Field(
        None,
        ge=1,
        le=2_000_000,
        description="initial number of Gaussians; none: half the budget for rigs and one camera on its path, else 8000",
    )
