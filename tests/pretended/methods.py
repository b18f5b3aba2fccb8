"""What has to be kept from torch's C++, which would look for CUDA at once: the few functions that move tensors by themselves."""

from __future__ import annotations

from contextlib import ExitStack
from typing import Any
from unittest.mock import patch

import torch
from torch import Tensor
from torch.overrides import _len_torch_function_stack
from torch.utils._device import _device_constructors

from . import syncs
from .tensor import CUDA, INSIDE, Pretended, inside

_apply = torch.autograd.Function.__dict__["apply"].__func__
_to, _tensor, _as_tensor, _asarray = Tensor.to, torch.tensor, torch.as_tensor, torch.asarray


def to(self: Tensor, *args: Any, **kwargs: Any) -> Tensor:
    if "device" in kwargs:
        kwargs["device"] = inside(kwargs["device"])
    return _to(self, *(inside(a) for a in args), **kwargs)


def cuda(self: Tensor, device: Any = None, non_blocking: bool = False, memory_format: Any = torch.preserve_format) -> Tensor:
    return _to(self, INSIDE, non_blocking=non_blocking, memory_format=memory_format)


def new_tensor(self: Tensor, data: Any, *, dtype: Any = None, device: Any = None, requires_grad: bool = False) -> Tensor:
    return tensor(data, dtype=dtype or self.dtype, device=self.device if device is None else device, requires_grad=requires_grad)


def _read(data: Any) -> Any:
    """A list's tensors on the device as ones on the CPU: torch reads them one by one."""
    if isinstance(data, (list, tuple)):
        return [_read(each) if isinstance(each, (list, tuple)) else _taken(each) for each in data]
    return data


def _taken(value: Any) -> Any:
    if not isinstance(value, Pretended):
        return value
    syncs.note("item")
    return value.numbers


def _wanted(device: Any) -> Any:
    """The device that is asked for, be it by `with torch.device(...)`."""
    return CUDA if device is None and _len_torch_function_stack() and torch.empty(0).is_cuda else device


def tensor(data: Any, *, dtype: Any = None, device: Any = None, requires_grad: bool = False, pin_memory: bool = False) -> Tensor:
    made = data.detach().clone() if isinstance(data, Tensor) else _tensor(_read(data), dtype=dtype, device="cpu")
    return to(made, _wanted(device), dtype).requires_grad_(requires_grad)


def as_tensor(data: Any, dtype: Any = None, device: Any = None) -> Tensor:
    made = data if isinstance(data, Tensor) else _as_tensor(_read(data), dtype=dtype, device="cpu")
    return to(made, _wanted(device), dtype)


def asarray(obj: Any, *, dtype: Any = None, device: Any = None, copy: Any = None, requires_grad: bool = False) -> Tensor:
    made = obj if isinstance(obj, Tensor) else _asarray(_read(obj), dtype=dtype, device="cpu", copy=copy)
    moved = to(made, _wanted(device), dtype)
    return (moved.clone() if copy and moved is obj else moved).requires_grad_(requires_grad)


def apply(cls: Any, *args: Any, **kwargs: Any) -> Any:
    """`Function.apply`, with the look at the gradients' devices that autograd spares tensors of subclasses."""
    result = _apply(cls, *args, **kwargs)
    there = [isinstance(a, Pretended) for a in args if isinstance(a, Tensor)]
    for out in result if isinstance(result, tuple) else (result,):
        node = getattr(out, "grad_fn", None)
        if type(node) is cls._backward_cls:
            node.register_hook(lambda grads, _: tuple(_arrived(cls.__name__, k, *each) for k, each in enumerate(zip(grads, there))))
            break
    return result


def _arrived(name: str, place: int, grad: Tensor | None, there: bool) -> Tensor | None:
    if grad is None or isinstance(grad, Pretended) == there:
        return grad
    if grad.dim() == 0:  # as autograd does
        return grad.to(CUDA if there else "cpu")
    devices = f"expected device {CUDA if there else 'cpu'} but got {grad.device}"
    raise RuntimeError(f"Function {name}Backward returned an invalid gradient at index {place} - {devices}")


def pin_memory(self: Tensor, device: Any = None) -> Tensor:
    return self.clone()


def patched() -> ExitStack:
    """Inside, these take torch's place."""
    _device_constructors()  # torch remembers which they are for good
    with ExitStack() as stack:
        stack.enter_context(patch.object(torch.autograd.Function, "apply", classmethod(apply)))
        for method in (to, cuda, new_tensor, pin_memory):
            stack.enter_context(patch.object(Tensor, method.__name__, method))
        for function in (tensor, as_tensor, asarray):
            stack.enter_context(patch.object(torch, function.__name__, function))
        return stack.pop_all()
