"""Which operators wait for the device, as `torch.cuda.set_sync_debug_mode` would tell."""

from __future__ import annotations

from typing import Any

import torch

from . import syncs
from .tensor import Pretended

aten = torch.ops.aten
ALWAYS = {
    aten._local_scalar_dense: "item",
    **{op: op.__name__ for op in (aten.nonzero, aten.masked_select, aten.equal, aten.bincount, aten._unique, aten._unique2)},
    **{op: op.__name__ for op in (aten.unique_dim, aten.unique_consecutive, aten.linalg_lstsq, aten._linalg_svd, aten.linalg_eig)},
    **{op: op.__name__ for op in (aten._linalg_eigh, aten._linalg_check_errors, aten.linalg_matrix_exp)},
}


def count(func: Any, args: tuple[Any, ...], kwargs: dict[str, Any], out_there: bool) -> None:
    """Note an operator that waits. out_there: whether its result is on the device."""
    op = func.overloadpacket
    if op in ALWAYS:
        syncs.note(ALWAYS[op])
    elif func is aten.repeat_interleave.Tensor and kwargs.get("output_size") is None:
        syncs.note("repeat_interleave")
    elif op is aten._to_copy:
        _copied(args[0], out_there, kwargs)
    elif op is aten.copy_:
        _copied(args[1], out_there, kwargs, *args[2:])
    elif op in (aten.index, aten._unsafe_index):
        _looked_up(args[1], out_there)
    elif op in (aten.index_put, aten.index_put_, aten._index_put_impl_, aten._unsafe_index_put):
        indices, value = [i for i in args[1] if i is not None], args[2]
        # One number of the CPU in all places of a mask is filled in, which asks for no places.
        if len(indices) != 1 or value.numel() != 1 or isinstance(value, Pretended) or not isinstance(indices[0], Pretended):
            _looked_up(indices, out_there)
        elif indices[0].dtype not in (torch.bool, torch.uint8):
            syncs.note("upload")
        if isinstance(value, Pretended) and not out_there:
            syncs.note("download")


def _copied(source: Any, out_there: bool, kwargs: dict[str, Any], non_blocking: bool = False) -> None:
    if isinstance(source, Pretended) != out_there and not (non_blocking or kwargs.get("non_blocking")):
        syncs.note("upload" if out_there else "download")


def _looked_up(indices: Any, out_there: bool) -> None:
    given = [i for i in indices if i is not None]
    if any(isinstance(i, Pretended) and i.dtype in (torch.bool, torch.uint8) for i in given):
        syncs.note("mask")
    if out_there and any(not isinstance(i, Pretended) for i in given):
        syncs.note("upload")
