"""Space for a frame's pairs inside a CUDA graph, where waiting for the device is not allowed and buffers are fixed at capture."""

from __future__ import annotations

import torch

from .state import Inputs

SPARE = 1.5  # factor on the most pairs that a frame of this size has taken so far

_TAKEN: dict[tuple[torch.device, int, int], int] = {}


def room_of(inputs: Inputs) -> int | None:
    """None outside of a capture. Inside one, the number of pairs to allocate: `SPARE` times the most that a frame on this device and of
    this size has taken so far, plus 1024.

    Raises RuntimeError inside a capture if there was no such frame.
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
    """Remember a frame's number of pairs if it is the largest so far for its device and size."""
    key = inputs.device, inputs.width, inputs.height
    _TAKEN[key] = max(pairs, _TAKEN.get(key, 0))
