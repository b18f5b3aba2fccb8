"""Reuses the measured flow of pairs whose pictures an earlier result has already processed."""

from __future__ import annotations

import numpy as np

from ...pipeline import ArtifactError, Context
from .artifact import StoredFlow


class TakenFlow:
    """Flow between the distorted pictures from ``ctx.earlier``, by index of the pair. Any thread may ask.

    method, size: how flow is measured now. Flow that was measured differently is not reused. The size depends on the motion in the whole
    capture, so a plan cannot know it.
    """

    def __init__(self, ctx: Context, method: str, size: int) -> None:
        self._flow: StoredFlow | None = None
        if ctx.earlier is None:
            return
        before, self._rows = StoredFlow(ctx.earlier.artifact), ctx.earlier.rows
        if not before.measured:
            return
        if (before.method, before.working_size) == (method, size):
            self._flow = before
        else:
            was = f"{before.method} at {before.working_size} px"
            ctx.log(
                f"the earlier result was measured with {was} (longest side), and this one with {method} at {size} px: nothing is reused"
            )

    def __contains__(self, p: int) -> bool:
        return self._flow is not None and p in self._rows

    def flow(self, p: int) -> tuple[np.ndarray, np.ndarray] | None:
        """Forward and backward flow, float32 [H, W, 2] px; None if the pair is new or its chunks can no longer be read."""
        if self._flow is None or p not in self._rows:
            return None
        try:
            forward, backward = self._flow.between_lens_pictures(self._rows[p])
        except ArtifactError:  # it was intact a moment ago; measuring gives the right result in any case
            return None
        return forward.astype(np.float32), backward.astype(np.float32)
