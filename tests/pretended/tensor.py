"""A tensor that says it lies on `cuda:0`, around one of the CPU that holds its numbers."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import Tensor

from . import syncs

CUDA = torch.device("cuda", 0)
# What C++ is told. The meta device is the only one beside the CPU that autograd serves in every build, in the thread of the caller.
INSIDE = torch.device("meta")


def is_cuda(device: Any) -> bool:
    """Whether a `device` argument names the device that is pretended, by either of its names."""
    if isinstance(device, bool) or not isinstance(device, (int, str, torch.device)):
        return False
    named = torch.device("cuda", device) if isinstance(device, int) else torch.device(device)
    if named.type == "cuda" and named.index:
        raise RuntimeError(f"CUDA error: invalid device ordinal ({named}; one device is pretended)")
    return named.type in ("cuda", INSIDE.type)


def inside(device: Any) -> Any:
    return INSIDE if is_cuda(device) else device


def places(index: Any) -> Any:
    """An index with lists of numbers brought to the device, of which torch's C++ would make tensors without any."""
    return tuple(_place(each) for each in index) if isinstance(index, tuple) else _place(index)


def _place(index: Any) -> Any:
    numbers = isinstance(index, (list, tuple)) and all(isinstance(each, (int, list, tuple)) for each in index)
    if numbers or isinstance(index, np.ndarray):
        return torch.tensor(index, dtype=None if len(index) else torch.long).to(CUDA)
    return index


class Pretended(Tensor):
    """What autograd sees: sizes, strides and a device of its own, and no memory. Every operation goes to `rules.run`."""

    numbers: Tensor
    __torch_function__ = torch._C._disabled_torch_function_impl  # type: ignore[assignment]

    @staticmethod
    def __new__(cls, numbers: Tensor) -> Pretended:
        about = {"strides": numbers.stride(), "storage_offset": numbers.storage_offset(), "dtype": numbers.dtype, "device": INSIDE}
        made: Pretended = Tensor._make_wrapper_subclass(cls, numbers.shape, **about)  # type: ignore[attr-defined]
        made.numbers = numbers
        return made

    @classmethod
    def __torch_dispatch__(cls, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        """In threads that `pretending_cuda` was not entered in, and after it has been left."""
        from .rules import run

        return run(func, args, kwargs or {})

    # What says where it is.

    device = property(lambda self: CUDA)  # type: ignore[assignment]
    is_cuda = property(lambda self: True)  # type: ignore[assignment]
    is_meta = property(lambda self: False)  # type: ignore[assignment]

    def get_device(self) -> int:
        return 0

    def data_ptr(self) -> int:
        return self.numbers.data_ptr()

    def untyped_storage(self) -> Any:
        return self.numbers.untyped_storage()

    def __repr__(self, **options: Any) -> str:  # type: ignore[override]
        grad = ", requires_grad=True" if self.requires_grad else ""
        return f"{repr(self.numbers)[:-1]}, device='cuda:0'{grad})"

    # What leaves torch.

    def numpy(self, *, force: bool = False) -> Any:
        if force:
            return self.detach().cpu().numpy()
        raise TypeError("can't convert cuda:0 device type tensor to numpy. Use Tensor.cpu() to copy the tensor to host memory first.")

    def tolist(self) -> Any:
        syncs.note("tolist")
        return self.numbers.tolist()

    def __dlpack__(self, *args: Any, **kwargs: Any) -> Any:
        raise BufferError("a tensor on a CUDA device that is pretended has no memory that others could read")

    def __dlpack_device__(self) -> tuple[int, int]:
        raise BufferError("a tensor on a CUDA device that is pretended has no memory that others could read")

    # What torch does beneath autograd, with the memory.

    def __getitem__(self, index: Any) -> Tensor:
        return super().__getitem__(places(index))

    def __setitem__(self, index: Any, value: Any) -> None:
        # Torch keeps numbers that go to a CUDA tensor on the CPU, which then need not be read back.
        if isinstance(value, (bool, int, float)):
            value = torch.tensor(value, dtype=self.dtype)
        super().__setitem__(places(index), value)

    @property
    def data(self) -> Tensor:  # type: ignore[override]
        return self.detach()

    @data.setter
    def data(self, value: Tensor) -> None:
        if not isinstance(value, Pretended) or value.dtype != self.dtype or value.shape != self.shape or value.stride() != self.stride():
            raise NotImplementedError("pretended: x.data = y wants a y of x's device, type, shape and strides")
        self.numbers = value.numbers

    def __format__(self, how: str) -> str:
        return format(self.item(), how) if self.dim() == 0 else super().__format__(how)

    def __deepcopy__(self, memo: dict[int, Any]) -> Tensor:
        if id(self) in memo:
            return memo[id(self)]
        if not self.is_leaf:
            raise RuntimeError("Only Tensors created explicitly by the user (graph leaves) support the deepcopy protocol at the moment.")
        copy = Pretended(self.numbers.clone()).requires_grad_(self.requires_grad)
        if isinstance(self, torch.nn.Parameter):
            copy = torch.nn.Parameter(copy, self.requires_grad)
        if self.grad is not None:
            copy.grad = self.grad.clone()
        memo[id(self)] = copy
        return copy
