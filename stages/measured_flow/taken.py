"""Measured flow of the pairs whose pictures an earlier result has seen."""

from __future__ import annotations

import numpy as np

from ...pipeline import ArtifactError, Context


class TakenFlow:
    """Flow between the lens's pictures, by number of the pair, from ``ctx.earlier``. Any thread may ask.

    method, size: how flow is measured now; what was measured otherwise does not count. The size follows from the motion in the whole
    capture, so that a plan cannot know it.
    """

    def __init__(self, ctx: Context, method: str, size: int) -> None:
        self._earlier = None
        if ctx.earlier is None or "forward" not in ctx.earlier.artifact:
            return
        before = ctx.earlier.artifact.attrs
        if (before["method"], before["working_size"]) == (method, size):
            self._earlier = ctx.earlier
            self._prefix = "lens_" if "lens_forward" in ctx.earlier.artifact else ""
        else:
            was = f"{before['method']} at {before['working_size']} px"
            ctx.log(f"the earlier result is of {was}, the longest side, and this one of {method} at {size} px: nothing is taken over")

    def __contains__(self, p: int) -> bool:
        return self._earlier is not None and p in self._earlier.rows

    def flow(self, p: int) -> tuple[np.ndarray, np.ndarray] | None:
        """Forward and backward, float32 [H, W, 2] px; None where the pair is new, or its chunks cannot be read any more."""
        if self._earlier is None or p not in self._earlier.rows:
            return None
        row = self._earlier.rows[p]
        try:
            forward, backward = (self._earlier.artifact.read(self._prefix + way, row) for way in ("forward", "backward"))
        except ArtifactError:  # all of it was sound a moment ago; measuring is right in any case
            return None
        return forward.astype(np.float32), backward.astype(np.float32)
