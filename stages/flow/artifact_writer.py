"""Writes a `flow` artifact, one pair or frame at a time. `artifact.py` reads it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ...pipeline import ArtifactWriter

if TYPE_CHECKING:
    import zarr


@dataclass(frozen=True)
class FlowArrays:
    """Arrays of P pairs and F frames of H x W px, to be filled from any thread. `StoredFlow` documents the rows."""

    forward: zarr.Array  # [P, H, W, 2] float16 px
    backward: zarr.Array  # [P, H, W, 2] float16 px
    confidence: zarr.Array  # [P, H, W] uint8
    edges: zarr.Array  # [F, H, W] uint8
    moving: zarr.Array | None  # [F, H, W] uint8


@dataclass(frozen=True)
class FlowWriter:
    """Writes the parts of a `flow` artifact. The pairs are always written, the rest only if something was measured."""

    out: ArtifactWriter

    def write_pairs(self, pairs: Sequence[tuple[int, int]]) -> None:
        """Pairs of a frame and the same camera's next frame; empty if nothing is measured."""
        self.out.write("pair", np.array(pairs, np.int32).reshape(-1, 2), doc="frame and the same camera's next frame")

    def write_static(self, static: bool, reason: str, largest_moving_share: float) -> None:
        """Whether the scene is static, why, and the largest share of a picture that moves."""
        self.out.attrs.update(static=static, static_reason=reason, largest_moving_share=round(largest_moving_share, 6))

    def write_method(self, name: str, working_size: int | None = None) -> None:
        """The method that measures the flow ("none" without pairs), and the longest side of the pictures it works on, px."""
        self.out.attrs["method"] = name
        if working_size is not None:
            self.out.attrs["working_size"] = working_size

    def create_arrays(self, pairs: int, frames: int, height: int, width: int, moving: bool) -> FlowArrays:
        """moving: whether frames get masks of moving pixels."""
        shape, chunk = (pairs, height, width, 2), (1, height, width, 2)
        of_frame, one = (frames, height, width), (1, height, width)
        create, shows = self.out.create, "255 = shows something that moves in the world; 0 outside training frames"
        sound = "255 = consistent forward and backward and not hidden, in the first frame"
        return FlowArrays(
            forward=create("forward", shape, "float16", chunk, unit="px", doc="flow to the second frame, u right, v down"),
            backward=create("backward", shape, "float16", chunk, unit="px", doc="flow from the second frame to the first"),
            confidence=create("confidence", shape[:3], "uint8", one, doc=sound),
            edges=create("edges", of_frame, "uint8", one, doc="255 = edge; 0 outside training frames"),
            moving=create("moving", of_frame, "uint8", one, doc=shows) if moving else None,
        )

    def create_lens_arrays(self, pairs: int, height: int, width: int) -> list[zarr.Array]:
        """Arrays for forward and backward flow between the distorted pictures, each [P, H, W, 2] float16 px."""
        shape, chunk = (pairs, height, width, 2), (1, height, width, 2)
        doc = "flow between the pictures as the lens made them, from which {} follows"
        ways = ("forward", "backward")
        return [self.out.create(f"lens_{way}", shape, "float16", chunk, unit="px", doc=doc.format(way)) for way in ways]

    def write_moving_share(self, share: float) -> None:
        """Mean share of the pixels of training frames that are moving."""
        self.out.attrs["moving_share"] = round(share, 6)

    def write_counts(self, static: int, measured: int, taken_over: int) -> None:
        """static: number of pairs between which nothing changes, so that their flow is zero. The others were measured or reused."""
        self.out.attrs["static_pairs"] = static
        self.out.info["pairs"] = {"measured": measured, "taken_over": taken_over}

    def write_ever_moving(self, masks: Mapping[int, np.ndarray]) -> None:
        """masks: for each fixed camera, by its index, uint8 [H, W]: 255 where a pixel changes over time."""
        self.out.write("ever_moving", np.stack(list(masks.values())), doc="255 where the pixel of a fixed camera changes over time")
        self.out.attrs["ever_moving_cameras"] = list(masks)
