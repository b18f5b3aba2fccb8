"""The row-sparse Adam step of many tensors on the GPU, taken only if it is finite; see `scene/cpu/adam.h` for the CPU version."""

from __future__ import annotations

import math
from collections.abc import Sequence
from ctypes import c_float, c_int32
from functools import lru_cache
from struct import Struct
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from ...rasterizer.cuda.runtime import Launcher
from .programs import program

THREADS = 256
CHUNK = 1024  # most numbers per block; a row may be wider
# `Entry` of adam.cu: parameter, gradient, first, second, pace, rows, width, first_block, parts, rows_each, divide, rate, inverse_root.
ENTRY = Struct("=5Q2q3iI2f")
SCALARS = np.dtype({"names": ["rate", "inverse_root"], "formats": ["<f4", "<f4"], "offsets": [72, 76], "itemsize": ENTRY.size})


class Update(NamedTuple):
    """A tensor of a step, contiguous float32. ``parameter`` and its moments ``first`` and ``second`` have the shape of ``gradient``; if
    there are none, the gradient is only checked. ``step`` counts from 1. ``pace`` [rows]: a factor on the rate of each row, or None."""

    gradient: Tensor
    parameter: Tensor | None = None
    first: Tensor | None = None
    second: Tensor | None = None
    step: int = 1
    rate: float = 0.0
    pace: Tensor | None = None


def step_if_finite(
    launcher: Launcher, device: torch.device, updates: Sequence[Update], beta1: float, beta2: float, epsilon: float
) -> Tensor:
    """One step of Adam, in place, for the rows (first axis) of each parameter whose gradient is not all zero; none if any number of any
    gradient is not finite. All tensors are on ``device``, which is the launcher's.

    Two launches and one upload, however many tensors there are. The call does not synchronise. Returns a tensor [1 + n] bool on the device:
    whether the step was not finite, and so not taken; then, for each of the updates, whether its gradient is not finite.

    Raises ValueError for other shapes, types, devices or steps, and whatever `Launcher.launch` raises.
    """
    return Table(updates, device).step(launcher, [(u.step, u.rate) for u in updates], beta1, beta2, epsilon)


class Table:
    """What the kernels of a step read of ``updates``, which can be used again for other steps and rates of the same tensors."""

    def __init__(self, updates: Sequence[Update], device: torch.device) -> None:
        table, self._blocks, self._device = bytearray(), 0, device
        for update in updates:
            entry, taken = _entry(update, device, self._blocks)
            table += entry
            self._blocks += taken
        self._count, self._end = len(updates), len(table)
        # What is found to be bad is written behind the table, where the upload has put zeros.
        self._bytes = table + bytes(1 + len(updates))
        self._scalars = np.frombuffer(self._bytes, SCALARS, len(updates))

    def step(self, launcher: Launcher, steps: Sequence[tuple[int, float]], beta1: float, beta2: float, epsilon: float) -> Tensor:
        """`step_if_finite` with these steps and rates."""
        if self._count:
            self._scalars[:] = [_scalars(step, rate, beta1, beta2) for step, rate in steps]
        uploaded = torch.frombuffer(self._bytes, dtype=torch.uint8).to(self._device, non_blocking=True)
        tensors, bad = uploaded[: self._end], uploaded[self._end :]
        found = torch.empty(self._blocks, dtype=torch.uint8, device=self._device)
        adam, common = program("adam"), (tensors, c_int32(self._count), found, bad)
        launcher.launch(adam, "check_gradients", self._blocks, THREADS, *common)
        launcher.launch(adam, "adam_rows", self._blocks, THREADS, *common, c_float(beta1), c_float(beta2), c_float(epsilon))
        return bad.view(torch.bool)


def _entry(update: Update, device: torch.device, first_block: int) -> tuple[bytes, int]:
    """The tensor's row of the table, without rate and step, and how many blocks it takes."""
    gradient, parameter, first, second, _, _, pace = update
    shape = gradient.shape
    addresses = []
    for t in (parameter, gradient, first, second):
        if t is None:
            addresses.append(0)
        elif t.shape == shape and t.dtype == torch.float32 and t.device == device and t.is_contiguous():
            addresses.append(t.data_ptr())
        else:
            given = f"{t.dtype} {list(t.shape)} on {t.device}{'' if t.is_contiguous() else ', not contiguous'}"
            raise ValueError(f"parameter and moments must be contiguous float32 {list(shape)} on {device}, as is the gradient; got {given}")
    if parameter is not None and (first is None or second is None):
        raise ValueError("a parameter needs both moments")
    rows = shape[0] if shape else 1
    if pace is not None and not (pace.shape == (rows,) and pace.dtype == torch.float32 and pace.device == device and pace.is_contiguous()):
        raise ValueError(f"pace must be contiguous float32 [{rows}] on {device}; got {pace.dtype} {list(pace.shape)} on {pace.device}")
    width = gradient.numel() // rows if rows else 0
    each, parts = 1, -(-width // CHUNK)
    if 0 < width <= CHUNK:
        each = CHUNK // width
        if each >= 64:
            each -= each % 8  # blocks of short rows start at a 32-byte sector
    divide = -(-(2**31) // width) if width else 0
    addresses.append(0 if pace is None else pace.data_ptr())
    return ENTRY.pack(*addresses, rows, width, first_block, parts, each, divide, 0.0, 0.0), -(-rows // each) * parts


def _scalars(step: int, rate: float, beta1: float, beta2: float) -> tuple[float, float]:
    """The rate with the first moment's bias correction, and the inverse root of the second's."""
    if step < 1:
        raise ValueError(f"the first step is number 1, got {step}")
    correction1, inverse_root = _corrections(step, beta1, beta2)
    return c_float(rate).value / correction1, inverse_root


@lru_cache(64)  # most tensors of a step have taken as many steps
def _corrections(step: int, beta1: float, beta2: float) -> tuple[float, float]:
    """The first moment's bias correction, and 1 / sqrt of the second's. With the last rounding to float32, which packing does, results are
    rounded in the same places as in the CPU kernel."""
    correction1, correction2 = c_float(1 - c_float(beta1).value ** step), c_float(1 - c_float(beta2).value ** step)
    return correction1.value, 1 / c_float(math.sqrt(correction2.value)).value
