"""Space for a frame's pairs, before their number is known."""

from __future__ import annotations

import torch

from .state import Inputs

SPARE = 1.25  # factor on what the last frames of this size took
GRAPH_SPARE = 1.5  # inside a CUDA graph, where pairs beyond the space are lost
FORGET = 0.98  # of that number is left after a frame that took less

_TAKEN: dict[tuple[torch.device, int, int], tuple[int, float]] = {}  # the most that a frame took, and what the last frames took


def room_in_graph(inputs: Inputs) -> int | None:
    """None outside of a capture. Inside one, where buffers are fixed and waiting for the device is not allowed, the number of pairs to
    allocate: `GRAPH_SPARE` times the most that a frame on this device and of this size has taken so far, plus 1024.

    Raises RuntimeError inside a capture if there was no such frame.
    """
    if inputs.device.type != "cuda" or not torch.cuda.is_current_stream_capturing():
        return None
    taken = _TAKEN.get((inputs.device, inputs.width, inputs.height))
    if taken is None:
        raise RuntimeError(
            f"a CUDA graph is being captured, and no frame of {inputs.width} x {inputs.height} was rendered on {inputs.device} "
            "before: render one first, from which the graph's buffers take their size"
        )
    return int(GRAPH_SPARE * taken[0]) + 1024


def likely_room(inputs: Inputs) -> int | None:
    """The number of pairs that will probably do for the next frame on this device and of this size; None if there was none yet."""
    taken = _TAKEN.get((inputs.device, inputs.width, inputs.height))
    return None if taken is None else int(SPARE * taken[1]) + 1024


def took(inputs: Inputs, pairs: int) -> None:
    """Remember a frame's number of pairs."""
    key = inputs.device, inputs.width, inputs.height
    most, lately = _TAKEN.get(key, (0, 0.0))
    _TAKEN[key] = max(pairs, most), max(pairs, FORGET * lately)
