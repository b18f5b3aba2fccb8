"""A GPU to measure on where there is none: the pretended one, with what benchmarks ask of torch beside tensors. Its times mean nothing."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from unittest.mock import patch

import torch
from pretend_cuda import pretending_cuda

ANSWERS = {
    "memory_allocated": 0,
    "max_memory_allocated": 1 << 20,
    "reset_peak_memory_stats": None,
    "mem_get_info": (1 << 27, 1 << 27),
}


@contextmanager
def pretended_gpu() -> Iterator[None]:
    asked = {name: lambda value=value: value for name, value in ANSWERS.items()}
    with pretending_cuda(), patch.multiple(torch.cuda, get_device_name=lambda index: "pretended", **asked):
        yield
