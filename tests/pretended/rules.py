"""Operators of tensors of which some say that they lie on a GPU: what CUDA refuses, and where the result lies.

This is below autograd, so that Python, autograd and custom functions all come here, for every operator of ATen.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from typing import Any

import torch
from torch import Tensor
from torch.utils._python_dispatch import TorchDispatchMode

from . import waits
from .tensor import Pretended, is_cuda

aten = torch.ops.aten
INDEXING = {aten.index, aten.index_put, aten.index_put_, aten._index_put_impl_, aten._unsafe_index, aten._unsafe_index_put}
COPIES = {aten.copy_, aten.copy, aten._to_copy}
# Others take numbers, tensors of the CPU without dimensions, beside tensors of the GPU. These look at each tensor's device.
STRICT = {
    *(aten.cat, aten.stack, aten.index_select, aten.index_add, aten.index_add_, aten.index_copy, aten.index_copy_),
    *(aten.index_fill, aten.index_fill_, aten.gather, aten.scatter, aten.scatter_, aten.scatter_add, aten.scatter_add_),
    *(aten.scatter_reduce, aten.scatter_reduce_, aten.take, aten.embedding, aten.searchsorted, aten.bucketize),
}


def run(func: Any, args: tuple[Any, ...], kwargs: dict[str, Any]) -> Any:
    """The operator's result as on hardware; RuntimeError where CUDA would raise one."""
    tensors = list(_tensors((args, kwargs)))
    there = any(isinstance(t, Pretended) for t in tensors)
    asked = kwargs.get("device")
    out_there = there if asked is None else is_cuda(asked)
    if not there and not out_there:
        return func(*args, **kwargs)
    if torch.is_inference_mode_enabled():
        with torch.inference_mode(False), torch.no_grad():
            return _run_composite(func, args, kwargs) if _composite(func) else run(func, args, kwargs)
    op = func.overloadpacket
    if op in INDEXING or op is aten.copy_:
        out_there = isinstance(args[0], Pretended)
    _check(func, args, kwargs, tensors, out_there)
    waits.count(func, args, kwargs, out_there)
    mine: dict[int, Tensor] = {id(t): t for t in tensors}
    inside, named = _plain(args, mine), _plain(kwargs, mine)
    if asked is not None:
        named["device"] = torch.device("cpu")
    if named.get("pin_memory"):
        named["pin_memory"] = False
    result = func(*inside, **named)
    if torch.Tag.inplace_view in func.tags and isinstance(args[0], Pretended):
        with torch._C._DisableTorchDispatch():  # sizes and strides of what autograd sees
            func(*args, **kwargs)
    return _wrapped(result, mine, out_there)


def _run_composite(func: Any, args: tuple[Any, ...], kwargs: dict[str, Any]) -> Any:
    """By its parts, into which autograd, which has no say in torch.inference_mode, takes such operators elsewhere."""
    with Mode():
        return func.decompose(*args, **kwargs)


class Mode(TorchDispatchMode):
    """Brings every operator here, also those without tensors, which may be asked for one on the device."""

    @classmethod
    def _should_skip_dynamo(cls) -> bool:
        return False  # nothing is compiled here, and what looks after it costs seconds to import

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        return run(func, args, kwargs or {})


@cache
def _composite(func: Any) -> bool:
    return torch._C._dispatch_has_kernel_for_dispatch_key(func.name(), torch._C.DispatchKey.CompositeImplicitAutograd)


def _tensors(tree: Any) -> Iterator[Tensor]:
    for each in tree.values() if isinstance(tree, dict) else tree:
        if isinstance(each, Tensor):
            yield each
        elif isinstance(each, (list, tuple, dict)):
            yield from _tensors(each)


def _plain(tree: Any, mine: dict[int, Tensor]) -> Any:
    """The same with tensors of the CPU; `mine` learns whose numbers they are, by their id."""
    if isinstance(tree, Pretended):
        mine[id(tree.numbers)] = tree
        return tree.numbers
    if isinstance(tree, (list, tuple)):
        return type(tree)(_plain(each, mine) for each in tree)
    if isinstance(tree, dict):
        return {key: _plain(value, mine) for key, value in tree.items()}
    return tree


def _wrapped(tree: Any, mine: dict[int, Tensor], there: bool) -> Any:
    if isinstance(tree, Tensor):
        known = mine.get(id(tree))
        if known is None:
            return Pretended(tree) if there else tree
        if known.shape != tree.shape or known.stride() != tree.stride():  # changed in place
            raise NotImplementedError("pretended: shape or strides of a tensor are changed in place")
        return known
    if isinstance(tree, (list, tuple)):
        return type(tree)(_wrapped(each, mine, there) for each in tree)
    return tree


def _check(func: Any, args: tuple[Any, ...], kwargs: dict[str, Any], tensors: list[Tensor], out_there: bool) -> None:
    generator = next((g for g in (*args, *kwargs.values()) if isinstance(g, torch.Generator)), None)
    if generator is not None and out_there:
        raise RuntimeError(f"Expected a 'cuda' device type for generator but found '{generator.device.type}'")
    op = func.overloadpacket
    strangers = [t for t in tensors if not isinstance(t, Pretended)]
    if not strangers or len(strangers) == len(tensors) or op in COPIES:
        return
    if op in INDEXING:
        # Places may be told from the CPU, and one number may come from anywhere.
        if not out_there and any(isinstance(i, Pretended) for i in args[1]):
            raise RuntimeError("indices should be either on cpu or on the same device as the indexed tensor (cpu)")
        value = args[2] if len(args) > 2 else None
        fine = value is None or value.numel() == 1 or isinstance(value, Pretended) == out_there
    elif op in STRICT or _writes_to(func, args, kwargs, strangers):
        fine = False
    else:
        fine = not any(t.dim() for t in strangers)
    if not fine:
        shapes = ", ".join(f"{list(t.shape)} on {t.device}" for t in tensors)
        raise RuntimeError(
            f"Expected all tensors to be on the same device, but found at least two devices, cuda:0 and cpu! ({func}: {shapes})"
        )


def _writes_to(func: Any, args: tuple[Any, ...], kwargs: dict[str, Any], strangers: list[Tensor]) -> bool:
    """Whether an operator would change a tensor of the CPU."""
    for place, argument in enumerate(func._schema.arguments):
        if argument.alias_info is not None and argument.alias_info.is_write:
            value = args[place] if place < len(args) else kwargs.get(argument.name)
            if any(value is stranger for stranger in strangers):
                return True
    return False
