"""A GPU to measure on where there is none: the pretended one, with what benchmarks ask of torch beside tensors. Its times mean nothing."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from types import SimpleNamespace
from typing import Any
from unittest.mock import patch

import torch
from pretend_cuda import pretending_cuda
from torch.autograd import DeviceType

ANSWERS = {
    "memory_allocated": 0,
    "max_memory_allocated": 1 << 20,
    "reset_peak_memory_stats": None,
    "mem_get_info": (1 << 27, 1 << 27),
}


@contextmanager
def profile(**asked: Any) -> Iterator[Any]:
    """`torch.profiler.profile` of a kernel that takes a microsecond, and of something on the CPU that does not count."""
    kinds = {"blend_forward": DeviceType.CUDA, "aten::empty": DeviceType.CPU}
    events = [SimpleNamespace(key=key, device_type=kind, self_device_time_total=1.0) for key, kind in kinds.items()]
    yield SimpleNamespace(key_averages=lambda: events)


@contextmanager
def pretended_gpu() -> Iterator[None]:
    asked = {name: lambda value=value: value for name, value in ANSWERS.items()}
    named = patch.multiple(torch.cuda, get_device_name=lambda index: "pretended", **asked)
    with pretending_cuda(), named, patch("torch.profiler.profile", profile):
        yield
