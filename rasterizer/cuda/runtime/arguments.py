"""The types of kernel arguments."""

from __future__ import annotations

import ctypes
from typing import TypeAlias

from torch import Tensor

# Each of these maps to exactly one type of kernel parameter. Python's int, float and bool are rejected: their width would be a guess.
Scalar: TypeAlias = (
    ctypes.c_bool
    | ctypes.c_int8
    | ctypes.c_uint8
    | ctypes.c_int16
    | ctypes.c_uint16
    | ctypes.c_int32
    | ctypes.c_uint32
    | ctypes.c_int64
    | ctypes.c_uint64
    | ctypes.c_float
    | ctypes.c_double
)
Argument: TypeAlias = Tensor | Scalar | None
