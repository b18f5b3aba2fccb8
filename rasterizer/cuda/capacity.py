"""Room for a frame's pairs where the device must not be waited for: inside a CUDA graph, whose buffers are fixed when it is captured."""

from __future__ import annotations

import torch

from .state import Inputs

SPARE = 1.5  # times what the last frame of this size took

_TAKEN: dict[tuple[torch.device, int, int], int] = {}


def room_of(inputs: Inputs) -> int | None:
    """None, or inside a capture how many pairs to make room for: `SPARE` times what the last frame of this device and size took before.

    Raises RuntimeError inside a capture without such a frame.
    """
    if inputs.device.type != "cuda" or not torch.cuda.is_current_stream_capturing():
        return None
    pairs = _TAKEN.get((inputs.device, inputs.width, inputs.height))
    if pairs is None:
        raise RuntimeError(
            f"a CUDA graph is being captured, and no frame of {inputs.width} x {inputs.height} was rendered on {inputs.device} "
            "before: render one first, from which the graph's buffers take their size"
        )
    return int(SPARE * pairs) + 1024


def took(inputs: Inputs, pairs: int) -> None:
    """Remember a frame's number of pairs, the most of those of its device and size."""
    key = inputs.device, inputs.width, inputs.height
    _TAKEN[key] = max(pairs, _TAKEN.get(key, 0))
