"""What kernels are given: refused by name if it is not what they take."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import torch
from torch import Tensor


def check(given: Mapping[str, tuple[Tensor | None, Sequence[int]]], **others: torch.dtype) -> None:
    """Raises ValueError for a tensor, by name, that has not its shape or is not float32, or of the type in ``others``. None is none."""
    for name, (tensor, shape) in given.items():
        dtype = others.get(name, torch.float32)
        if tensor is not None and (tensor.shape != tuple(shape) or tensor.dtype != dtype):
            wanted, found = (str(one).removeprefix("torch.") for one in (dtype, tensor.dtype))
            raise ValueError(f"{name} must be {list(shape)} {wanted}, got {list(tensor.shape)} {found}")
