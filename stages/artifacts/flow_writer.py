"""Filling a `flow` artifact, a pair or a frame at a time. `flow.py` reads it."""

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
    """Arrays of P pairs and F frames of H x W px to be filled from any thread; `StoredFlow` says what each row holds."""

    forward: zarr.Array  # [P, H, W, 2] float16 px
    backward: zarr.Array  # [P, H, W, 2] float16 px
    confidence: zarr.Array  # [P, H, W] uint8
    edges: zarr.Array  # [F, H, W] uint8
    movers: zarr.Array | None  # [F, H, W] uint8


@dataclass(frozen=True)
class FlowWriter:
    """What may be written of a `flow` artifact: the pairs always, all else where something was measured."""

    out: ArtifactWriter

    def write_pairs(self, pairs: Sequence[tuple[int, int]]) -> None:
        """Pairs of a frame and the same camera's next frame; none where nothing is measured."""
        self.out.write("pair", np.array(pairs, np.int32).reshape(-1, 2), doc="frame and the same camera's next frame")

    def write_static(self, static: bool, reason: str, moving_share: float) -> None:
        """Whether nothing moves in the scene, why, and the share of the pixels that do."""
        self.out.attrs.update(static=static, static_reason=reason, moving_share=round(moving_share, 6))

    def write_method(self, name: str, working_size: int | None = None) -> None:
        """What measures the flow ("none" without pairs), and the longest side of the pictures at which it does, px."""
        self.out.attrs["method"] = name
        if working_size is not None:
            self.out.attrs["working_size"] = working_size

    def create_arrays(self, pairs: int, frames: int, height: int, width: int, movers: bool) -> FlowArrays:
        """movers: whether frames have masks of what moves in them."""
        shape, chunk = (pairs, height, width, 2), (1, height, width, 2)
        of_frame, one = (frames, height, width), (1, height, width)
        create, moving = self.out.create, "255 = shows something that moves in the world; 0 outside training frames"
        sound = "255 = consistent forward and backward and not hidden, in the first frame"
        return FlowArrays(
            forward=create("forward", shape, "float16", chunk, unit="px", doc="flow to the second frame, u right, v down"),
            backward=create("backward", shape, "float16", chunk, unit="px", doc="flow from the second frame to the first"),
            confidence=create("confidence", shape[:3], "uint8", one, doc=sound),
            edges=create("edges", of_frame, "uint8", one, doc="255 = edge; 0 outside training frames"),
            movers=create("movers", of_frame, "uint8", one, doc=moving) if movers else None,
        )

    def create_lens_arrays(self, pairs: int, height: int, width: int) -> list[zarr.Array]:
        """Forward and backward between the pictures as the lens made them, [P, H, W, 2] float16 px."""
        shape, chunk = (pairs, height, width, 2), (1, height, width, 2)
        doc = "flow between the pictures as the lens made them, from which {} follows"
        ways = ("forward", "backward")
        return [self.out.create(f"lens_{way}", shape, "float16", chunk, unit="px", doc=doc.format(way)) for way in ways]

    def write_movers_share(self, share: float) -> None:
        """Mean share of the pixels of training frames that show something that moves."""
        self.out.attrs["movers_share"] = round(share, 6)

    def write_counts(self, still: int, measured: int, taken_over: int) -> None:
        """Pairs between which nothing changes, whose flow is zero, and what became of the others."""
        self.out.attrs["still_pairs"] = still
        self.out.info["pairs"] = {"measured": measured, "taken_over": taken_over}

    def write_moving(self, masks: Mapping[int, np.ndarray]) -> None:
        """Of each fixed camera, by its number, uint8 [H, W]: 255 where a pixel changes over time."""
        self.out.write("moving", np.stack(list(masks.values())), doc="255 where the pixel of a fixed camera changes over time")
        self.out.attrs["moving_cameras"] = list(masks)
