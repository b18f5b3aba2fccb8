"""Parameters as other leaves of autograd's graph, in the same memory."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from torch import nn


@contextmanager
def own_leaves(*modules: nn.Module | None) -> Iterator[None]:
    """Inside, the parameters of ``modules`` are leaves of their own. A capture needs that: as long as a result of the usual leaves lives,
    autograd adds their gradients up on the stream of that result, which is not the stream of the capture."""
    parts = [part for module in modules if module is not None for part in module.modules()]
    kept = [(part, dict(part._parameters)) for part in parts]
    try:
        for part, parameters in kept:
            own = {name: p if p is None else nn.Parameter(p.detach(), p.requires_grad) for name, p in parameters.items()}
            part._parameters.update(own)
        yield
    finally:
        for part, parameters in kept:
            part._parameters.update(parameters)
