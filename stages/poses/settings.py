"""The settings of `poses`."""

from __future__ import annotations

from typing import ClassVar, Literal

from pydantic import Field

from ...pipeline import Settings
from ...vision.sfm.pairs import OVERLAP


class PosesSettings(Settings):
    renamed: ClassVar = {"movers": "poses.moving"}
    respelled: ClassVar = {"matcher": {"auto": None}, "moving": {"auto": True, "off": False}}

    matcher: Literal["sequential", "exhaustive"] | None = Field(
        None, description="which images are matched; none: all, up to 40 images or with --static; else neighbours and keyframes"
    )
    overlap: int = Field(OVERLAP, ge=2, le=100, description="sequential: number of following frames that each frame is matched with")
    camera_model: Literal["SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV"] = Field(
        "SIMPLE_RADIAL", description="lens model that is fitted; OPENCV suits wide lenses with many images"
    )
    max_features: int | None = Field(
        None, ge=256, le=65_536, description="most SIFT features per image; none: 8192, of over 100 frames 3000"
    )
    mapper: Literal["incremental", "global"] = Field("incremental", description="COLMAP's incremental mapper or the global one (GLOMAP)")
    moving: bool = Field(
        True, description="a second pass without features on moving objects, if there are enough of these; the better pass is kept"
    )
    seed: int = Field(0, ge=0, le=2**31 - 1, description="seed of the random sampling")
