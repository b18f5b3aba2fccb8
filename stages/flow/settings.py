"""The settings of `flow`."""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar, Literal

from pydantic import Field

from ...pipeline import Settings


class FlowSettings(Settings):
    renamed: ClassVar = {"movers": "flow.moving"}
    respelled: ClassVar = {"method": {"auto": None}}

    method: Literal["raft", "raft-small", "dis"] | None = Field(
        None,
        description="none: RAFT if weights are given, else OpenCV's dense inverse search (DIS); raft without weights uses torchvision's",
    )
    weights: Path | None = Field(None, description="published weights of RAFT, basic or small, as safetensors or .pth")
    iterations: int = Field(20, ge=1, le=100, description="most updates of RAFT")
    tolerance: float = Field(0.05, ge=0, le=10, description="px; RAFT stops after an update that changes the flow by less")
    preset: Literal["ultrafast", "fast", "medium"] = Field("medium", description="speed of DIS; medium is the most accurate")
    max_size: int | None = Field(960, ge=64, le=65_536, description="px; flow of larger pictures is computed at this longest side")
    max_pairs: int | None = Field(None, ge=0, le=1_000_000, description="most pairs, spread evenly; none: 400, or 600 of one camera")
    detect_static: bool = Field(True, description="first check whether anything moves; if nothing does, no flow is measured")
    moving: bool = Field(
        True, description="masks of moving pixels in each frame: flow minus camera motion, or changes that a fixed camera sees"
    )
    grow: int = Field(4, ge=0, le=100, description="px by which the mask of all pixels that ever change in a fixed camera is widened")
