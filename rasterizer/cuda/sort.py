"""Stable sorting on the GPU, with 32-bit values and without waiting for it."""

from __future__ import annotations

from ctypes import c_int32, c_int64

import torch
from torch import Tensor

from . import programs
from .runtime import Launcher

THREADS = 256
ITEMS = 8  # keys of a thread; kItems in sort.cu
COUNT_BLOCKS = 512  # at most, for counting digits
HEAD = 8 + 8 * 256  # numbers in the workspace before those of the blocks; kPublished in sort.cu


def space(n: int) -> int:
    """The length of the workspace that `sort` needs for ``n`` keys."""
    return HEAD + 256 * -(-n // (THREADS * ITEMS))


def sort(
    launcher: Launcher,
    keys: Tensor,
    values: Tensor | None = None,
    keep_keys: bool = True,
    number: Tensor | None = None,
    workspace: Tensor | None = None,
) -> tuple[Tensor | None, Tensor]:
    """``keys`` [n] in ascending order, or None without ``keep_keys``, and their ``values`` [n] int32 in the same order; without values,
    the index of each. Equal keys keep their order.

    keys: int16, int32 or int64, not below zero; so are the bits of positive doubles, which sort alike. Both are overwritten.
    number: [1] int64 on the device, how many of the keys are sorted, at most n; the rest of the results is undefined. None: all.
    workspace: [space(n)] int64 zeros; None: made here.
    """
    n, width, device = keys.shape[0], keys.element_size(), keys.device
    program = programs.sort(width)
    blocks = -(-n // (THREADS * ITEMS))
    workspace = torch.zeros(space(n), dtype=torch.int64, device=device) if workspace is None else workspace
    size = c_int64(n), number
    launcher.launch(program, "count_digits", min(blocks, COUNT_BLOCKS), THREADS, *size, keys, workspace)
    # Each step reads what the one before it wrote, and writes over what that one read.
    every_keys = torch.empty_like(keys), keys
    every_values = [torch.empty(n, dtype=torch.int32, device=device) for _ in range(2 if values is None else 1)]
    every_values += [] if values is None else [values]
    for step in range(width):
        to_keys, to_values = every_keys[step % 2], every_values[step % 2]
        kept = to_keys if keep_keys or step < width - 1 else None
        launcher.launch(program, "sort_digit", blocks, THREADS, *size, c_int32(step), keys, values, kept, to_values, workspace)
        keys, values = to_keys, to_values
    assert values is not None
    return (keys if keep_keys else None), values
