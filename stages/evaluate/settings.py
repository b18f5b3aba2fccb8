"""The settings of `evaluate`."""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar, Literal

from pydantic import Field

from ...pipeline import Settings

Split = Literal["train", "val", "test"]


class EvaluateSettings(Settings):
    dropped: ClassVar = {"picture_size": "pictures of the report are at most 640 px"}

    splits: tuple[Split, ...] = Field(("val", "test"), min_length=1, description="splits to measure, separated by commas")
    max_views: int = Field(8, ge=0, le=1000, description="most views of each split in the report, half of them the worst")
    measured: int | None = Field(
        None,
        ge=1,
        le=1_000_000,
        description="most views of each split that are measured, spread evenly; none: one for each 50 steps of training, at least 32",
    )
    movie_frames: int = Field(60, ge=0, le=1000, description="pictures in each of the report's two movies; 0: no movies")
    player: bool = Field(True, description="put the scene itself into the report, where it plays and can be turned; at most 8 MB")
    lpips_weights: Path | None = Field(
        None, description="safetensors file with the network's weights; none: the published ones, which e4dgs[lpips] brings"
    )
    lpips_net: Literal["alex", "vgg"] = Field("alex", description="network of LPIPS")
