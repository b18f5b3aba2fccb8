"""The row-sparse Adam step of many tensors on the GPU, taken only if it is finite; see `scene/cpu/adam.h` for the CPU version."""

from __future__ import annotations

import math
from collections.abc import Sequence
from ctypes import c_float, c_int32
from struct import Struct
from typing import NamedTuple

import torch
from torch import Tensor

from ...rasterizer.cuda.runtime import Launcher
from .programs import program

THREADS = 256
CHUNK = 1024  # most numbers per block; a row may be wider
# `Entry` of adam.cu: parameter, gradient, first, second, rows, width, first_block, parts, rows_each, divide, rate, inverse_root.
ENTRY = Struct("=4Q2q3iI2f")


class Update(NamedTuple):
    """A tensor of a step, contiguous float32. ``parameter`` and its moments ``first`` and ``second`` have the shape of ``gradient``; if
    there are none, the gradient is only checked. ``step`` counts from 1."""

    gradient: Tensor
    parameter: Tensor | None = None
    first: Tensor | None = None
    second: Tensor | None = None
    step: int = 1
    rate: float = 0.0


def step_if_finite(
    launcher: Launcher, device: torch.device, updates: Sequence[Update], beta1: float, beta2: float, epsilon: float
) -> Tensor:
    """One step of Adam, in place, for the rows (first axis) of each parameter whose gradient is not all zero; none if any number of any
    gradient is not finite. All tensors are on ``device``, which is the launcher's.

    Two launches and one upload, however many tensors there are. The call does not synchronise. Returns a tensor [1 + n] bool on the device:
    whether the step was not finite, and so not taken; then, for each of the updates, whether its gradient is not finite.

    Raises ValueError for other shapes, types, devices or steps, and whatever `Launcher.launch` raises.
    """
    table, blocks = bytearray(), 0
    for update in updates:
        _check(update, device)
        entry, taken = _entry(update, blocks, beta1, beta2)
        table += entry
        blocks += taken
    # What is found to be bad is written behind the table, where the upload has put zeros.
    end = len(table)
    uploaded = torch.frombuffer(table + bytes(1 + len(updates)), dtype=torch.uint8).to(device, non_blocking=True)
    tensors, bad = uploaded[:end], uploaded[end:]
    found = torch.empty(blocks, dtype=torch.uint8, device=device)
    adam, common = program("adam"), (tensors, c_int32(len(updates)), found, bad)
    launcher.launch(adam, "check_gradients", blocks, THREADS, *common)
    launcher.launch(adam, "adam_rows", blocks, THREADS, *common, c_float(beta1), c_float(beta2), c_float(epsilon))
    return bad.view(torch.bool)


def _check(update: Update, device: torch.device) -> None:
    gradient, *others = tensors = [t for t in update[:4] if isinstance(t, Tensor)]
    if any(t.shape != gradient.shape for t in others):
        raise ValueError(f"parameter and moments must have the gradient's shape; got {', '.join(str(tuple(t.shape)) for t in tensors)}")
    if any(t.dtype != torch.float32 or t.device != device or not t.is_contiguous() for t in tensors):
        given = ", ".join(f"{t.dtype} on {t.device}{'' if t.is_contiguous() else ', not contiguous'}" for t in tensors)
        raise ValueError(f"parameter, gradient and moments must be contiguous float32 on {device}; got {given}")
    if len(tensors) not in (1, 4):
        raise ValueError("a parameter needs both moments")
    if update.step < 1:
        raise ValueError(f"the first step is number 1, got {update.step}")


def _entry(update: Update, first_block: int, beta1: float, beta2: float) -> tuple[bytes, int]:
    """The tensor's row of the table, and how many blocks it takes."""
    addresses = [0 if t is None else t.data_ptr() for t in (update.parameter, update.gradient, update.first, update.second)]
    size = update.gradient.numel()
    rows = update.gradient.shape[0] if update.gradient.ndim else 1
    width = size // rows if rows else 0
    each, parts = 1, -(-width // CHUNK)
    if 0 < width <= CHUNK:
        each = CHUNK // width
        if each >= 64:
            each -= each % 8  # blocks of short rows start at a 32-byte sector
    divide = -(-(2**31) // width) if width else 0
    scalars = _scalars(update.step, update.rate, beta1, beta2)
    return ENTRY.pack(*addresses, rows, width, first_block, parts, each, divide, *scalars), -(-rows // each) * parts


def _scalars(step: int, rate: float, beta1: float, beta2: float) -> tuple[float, float]:
    """rate and inverse_root, rounded to float32 in the same places as in the CPU kernel; the last rounding is that of packing."""
    correction1, correction2 = c_float(1 - c_float(beta1).value ** step), c_float(1 - c_float(beta2).value ** step)
    root = c_float(math.sqrt(correction2.value))
    return c_float(rate).value / correction1.value, 1 / root.value
