"""The row-sparse Adam step on the GPU; see `scene/cpu/adam.h` for the CPU version."""

from __future__ import annotations

import math
from ctypes import c_float, c_int32, c_int64, c_uint32

import torch
from torch import Tensor

from ...rasterizer.cuda.runtime import Launcher
from .programs import program

THREADS = 256
CHUNK = 1024  # numbers per block; rows up to this length are narrow


def adam_rows(
    launcher: Launcher,
    parameter: Tensor,
    grad: Tensor,
    first: Tensor,
    second: Tensor,
    step: int,
    rate: float,
    beta1: float,
    beta2: float,
    epsilon: float,
) -> None:
    """One step of Adam, in place, for the rows (first axis) of ``parameter`` whose gradient is not all zero; NaN counts as nonzero.

    All tensors are contiguous float32 of the same shape on the launcher's device; the moments ``first`` and ``second`` are updated, too.
    ``step`` counts from 1. The call does not synchronise; a CUDA graph keeps the step and the rate that it was captured with.

    Raises ValueError for other shapes, types or steps, and whatever `Launcher.launch` raises.
    """
    tensors = (parameter, grad, first, second)
    if any(t.shape != parameter.shape for t in tensors):
        raise ValueError(f"gradient and moments must have the parameter's shape; got {', '.join(str(tuple(t.shape)) for t in tensors)}")
    if any(t.dtype != torch.float32 for t in tensors):
        raise ValueError(f"parameter, gradient and moments must be float32; got {', '.join(str(t.dtype) for t in tensors)}")
    if step < 1:
        raise ValueError(f"the first step is number 1, got {step}")
    size = parameter.numel()
    if not size:
        return
    rows = parameter.shape[0] if parameter.ndim else 1
    width = size // rows
    adam = program("adam")
    scalars = _scalars(step, rate, beta1, beta2, epsilon)
    if width <= CHUNK:
        each = CHUNK // width
        if each >= 64:
            each -= each % 8  # blocks of short rows start at a 32-byte sector
        shape = (c_int64(rows), c_int32(width), c_int32(each), c_uint32(-(-(2**31) // width)))
        launcher.launch(adam, "adam_narrow", -(-rows // each), THREADS, *shape, parameter, grad, first, second, *scalars)
        return
    parts = -(-width // CHUNK)
    blocks = rows * parts
    found = parameter.new_empty(blocks, dtype=torch.uint8)
    one = (c_int64(width), c_int32(parts))
    launcher.launch(adam, "find_gradients", blocks, THREADS, *one, grad, found)
    launcher.launch(adam, "adam_wide", blocks, THREADS, *one, found, parameter, grad, first, second, *scalars)


def _scalars(step: int, rate: float, beta1: float, beta2: float, epsilon: float) -> tuple[c_float, ...]:
    """rate, beta1, beta2, epsilon, inverse_root, rounded to float32 in the same places as in the CPU kernel."""
    one, two = c_float(beta1), c_float(beta2)
    correction1, correction2 = c_float(1 - one.value**step), c_float(1 - two.value**step)
    root = c_float(math.sqrt(correction2.value))
    return c_float(c_float(rate).value / correction1.value), one, two, c_float(epsilon), c_float(1 / root.value)
