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


def sort(launcher: Launcher, keys: Tensor, values: Tensor | None = None, keep_keys: bool = True) -> tuple[Tensor | None, Tensor]:
    """``keys`` [n] in ascending order, or None without ``keep_keys``, and their ``values`` [n] int32 in the same order; without values,
    the index of each. Equal keys keep their order.

    keys: int16, int32 or int64, not below zero; so are the bits of positive doubles, which sort alike. Both are overwritten.
    """
    n, width, device = keys.shape[0], keys.element_size(), keys.device
    program = programs.sort(width)
    blocks = -(-n // (THREADS * ITEMS))
    workspace = torch.zeros(HEAD + 256 * blocks, dtype=torch.int64, device=device)
    launcher.launch(program, "count_digits", min(blocks, COUNT_BLOCKS), THREADS, c_int64(n), keys, workspace)
    # Each step reads what the one before it wrote, and writes over what that one read.
    every_keys = torch.empty_like(keys), keys
    every_values = [torch.empty(n, dtype=torch.int32, device=device) for _ in range(2 if values is None else 1)]
    every_values += [] if values is None else [values]
    for step in range(width):
        to_keys, to_values = every_keys[step % 2], every_values[step % 2]
        kept = to_keys if keep_keys or step < width - 1 else None
        launcher.launch(program, "sort_digit", blocks, THREADS, c_int64(n), c_int32(step), keys, values, kept, to_values, workspace)
        keys, values = to_keys, to_values
    assert values is not None
    return (keys if keep_keys else None), values
