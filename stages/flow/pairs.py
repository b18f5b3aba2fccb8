"""Flow of the pairs of a capture: measured between the distorted pictures, or reused from an earlier result."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np

from ...pipeline import Context
from ...vision.flow.method import FlowMethod, Prepared, open_method
from ...vision.flow.two_way import FlowPair, both_ways, trusted
from ..shared.frameset import FrameSet
from .artifact_writer import FlowWriter
from .lens import straightened
from .scout import glance, no_motion, working_size
from .taken import TakenFlow

if TYPE_CHECKING:
    import zarr

STEPS = 32  # stored flow is a multiple of 1/32 px, a tenth of the error of DIS; the array then compresses to a third
LIMIT = 65504.0  # px, the largest float16

Source = Literal["measured", "taken", "static"]


class Shown(NamedTuple):
    """picture: the distorted picture, uint8 [H, W, 3]. glance: a small version that shows whether anything moves. prepared: the input of
    the flow method, if flow has to be measured."""

    picture: np.ndarray
    glance: np.ndarray
    prepared: Prepared | None


class PairFlows:
    """Flow of the pairs that begin at the frames ``wanted``. Each pair is requested once, from any thread. ``method``: None without pairs.

    Also writes the name of the method and, for lenses with distortion, the flow between the distorted pictures.
    """

    def __init__(self, ctx: Context, frames: FrameSet, wanted: Sequence[int], out: FlowWriter) -> None:
        self._frames, self._device = frames, ctx.device
        self._pairs = [(first, int(frames.next[first])) for first in wanted]
        self._lens: list[zarr.Array] = []
        self.method: FlowMethod | None = None
        if not wanted:
            out.write_method(self.method_name)
            return
        size, motion = working_size(frames, wanted, ctx.settings.max_size)
        if size < min(max(frames.width, frames.height), ctx.settings.max_size or 1 << 30):
            ctx.log(f"motion is at most {motion:.1f} px: flow is measured at {size} px (longest side)")
        given = ctx.settings
        self.method = open_method(given.method, given.weights, given.preset, given.iterations, given.tolerance, ctx.device, size)
        out.write_method(self.method_name, size)
        self._taken = TakenFlow(ctx, self.method.name, size)
        self._new = {i for p, pair in enumerate(self._pairs) if p not in self._taken for i in pair}
        if any(frames.bent(i) for pair in self._pairs for i in pair):
            self._lens = out.create_lens_arrays(len(wanted), frames.height, frames.width)

    @property
    def method_name(self) -> str:
        """ "none" without pairs."""
        return "none" if self.method is None else self.method.name

    def shown(self, i: int, picture: np.ndarray) -> Shown:
        """Prepares frame i of a pair. ``picture``: its distorted picture."""
        assert self.method is not None
        return Shown(picture, glance(picture), self.method.prepare(picture) if i in self._new else None)

    def between(self, p: int, first: Shown, second: Shown) -> tuple[FlowPair, Source]:
        """Flow of pair p between pinhole pictures, rounded to what float16 stores, and its source."""
        if no_motion(first.glance, second.glance):
            zero = np.zeros((*first.picture.shape[:2], 2), np.float32)
            for array in self._lens:
                array[p] = zero
            return FlowPair(zero, zero, np.full(zero.shape[:2], 255, np.uint8)), "static"
        taken = self._taken.flow(p)
        forward, backward = taken or self._measured(first, second)
        if self._lens:
            self._lens[0][p], self._lens[1][p] = forward, backward
            i, j = self._pairs[p]
            forward = stored(straightened(self._frames, i, j, forward, self._device))
            backward = stored(straightened(self._frames, j, i, backward, self._device))
        return trusted(forward, backward, self._device), "taken" if taken else "measured"

    def _measured(self, first: Shown, second: Shown) -> tuple[np.ndarray, np.ndarray]:
        assert self.method is not None
        a, b = (one.prepared or self.method.prepare(one.picture) for one in (first, second))
        forward, backward = both_ways(self.method, a, b)
        return stored(forward), stored(backward)


def stored(flow: np.ndarray) -> np.ndarray:
    """``flow`` as float32, with the values that it has after being stored as float16."""
    return (np.rint(np.clip(flow, -LIMIT, LIMIT) * STEPS) / STEPS).astype(np.float16).astype(np.float32)
