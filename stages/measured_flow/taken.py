"""Measured flow of the pairs whose pictures an earlier result has seen."""

from __future__ import annotations

import numpy as np

from ...pipeline import ArtifactError, Context
from ..artifacts.flow import StoredFlow


class TakenFlow:
    """Flow between the lens's pictures, by number of the pair, from ``ctx.earlier``. Any thread may ask.

    method, size: how flow is measured now; what was measured otherwise does not count. The size follows from the motion in the whole
    capture, so that a plan cannot know it.
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
            ctx.log(f"the earlier result is of {was}, the longest side, and this one of {method} at {size} px: nothing is taken over")

    def __contains__(self, p: int) -> bool:
        return self._flow is not None and p in self._rows

    def flow(self, p: int) -> tuple[np.ndarray, np.ndarray] | None:
        """Forward and backward, float32 [H, W, 2] px; None where the pair is new, or its chunks cannot be read any more."""
        if self._flow is None or p not in self._rows:
            return None
        try:
            forward, backward = self._flow.between_lens_pictures(self._rows[p])
        except ArtifactError:  # all of it was sound a moment ago; measuring is right in any case
            return None
        return forward.astype(np.float32), backward.astype(np.float32)
