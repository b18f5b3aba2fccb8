"""Arguments of a launch against the parameters of the kernel, which its compiled table describes."""

from __future__ import annotations

import ctypes

import torch
from torch import Tensor

from .error import SimtError

KINDS = {b"f": "floating", b"i": "integer", b"?": "other"}


class Parameter(ctypes.Structure):
    """`Parameter` of runtime.h."""

    _fields_ = (("name", ctypes.c_char_p), ("passed", ctypes.c_char), ("element", ctypes.c_char), ("size", ctypes.c_int32))


class Kernel(ctypes.Structure):
    """`Kernel` of runtime.h."""

    _fields_ = (
        ("name", ctypes.c_char_p),
        ("call", ctypes.c_void_p),
        ("parameters", ctypes.POINTER(Parameter)),
        ("n_parameters", ctypes.c_int32),
        ("bound", ctypes.c_int32),
    )


INTEGERS = ("c_bool", "c_int8", "c_uint8", "c_int16", "c_uint16", "c_int32", "c_uint32", "c_int64", "c_uint64")
SCALARS = {getattr(ctypes, name): b"i" for name in INTEGERS} | {ctypes.c_float: b"f", ctypes.c_double: b"f"}


def address(parameter: Parameter, argument: Tensor | ctypes._SimpleCData | None) -> ctypes._SimpleCData:
    """The value to pass; raises SimtError where the parameter is something else. Bytes (uint8) may hold anything."""
    name = parameter.name.decode()
    if parameter.passed == b"s":
        wanted = f"{name} is a scalar ({KINDS[parameter.element]}, {parameter.size} bytes)"
        if type(argument) not in SCALARS:
            raise SimtError(f"{wanted}, and was given {describe(argument)}")
        if (SCALARS[type(argument)], ctypes.sizeof(argument)) != (parameter.element, parameter.size):
            raise SimtError(f"{wanted}, and was given a {type(argument).__name__}")
        return argument
    if argument is None:
        return ctypes.c_void_p()
    if not isinstance(argument, Tensor):
        raise SimtError(f"{name} is a pointer, and was given {describe(argument)}")
    if argument.device.type != "cpu" or not argument.is_contiguous():
        raise SimtError(f"{name} must be a contiguous tensor on the CPU, and was given {describe(argument)}")
    element = b"f" if argument.dtype.is_floating_point else b"i"
    raw = argument.dtype == torch.uint8 or parameter.element == b"?" or parameter.size == 1
    if not raw and (element, argument.element_size()) != (parameter.element, parameter.size):
        raise SimtError(f"{name} points to {KINDS[parameter.element]} of {parameter.size} bytes, and was given {describe(argument)}")
    return ctypes.c_void_p(argument.data_ptr())


def describe(argument: object) -> str:
    if not isinstance(argument, Tensor):
        return f"a {type(argument).__name__}"
    strides = "" if argument.is_contiguous() else f" with strides {list(argument.stride())}"
    return f"a {argument.dtype} tensor {list(argument.shape)}{strides} on {argument.device}"
