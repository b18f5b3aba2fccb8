"""Inputs of a step in memory that CUDA graphs read, into which each replay copies its own. See `steps.inputs` for what inputs are."""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable
from dataclasses import replace
from typing import Any, NamedTuple

import torch
from torch import Tensor

from ....rasterizer import Camera


class _Part(NamedTuple):
    """Where numbers that travel together have one input: ``shape`` of them, from ``start`` on. whole: as a whole number."""

    start: int
    shape: tuple[int, ...]
    whole: bool


class Buffers:
    """Memory on ``device`` for inputs of the structure of ``inputs``, which it holds until `fill`.

    Numbers, and what has float32 numbers on the CPU, such as cameras, travel in one copy: each copy takes the host some time. Whole
    numbers must be below 2^24. Every other tensor, such as a picture that is on the device already, has memory of its own.
    """

    def __init__(self, inputs: Any, device: torch.device) -> None:
        self._own: list[Tensor] = []
        count = 0

        def place(leaf: Any) -> Any:
            nonlocal count
            if not _travels(leaf):
                self._own.append(torch.empty_like(leaf, device=device))
                return self._own[-1]
            part = _Part(count, tuple(getattr(leaf, "shape", ())), isinstance(leaf, int))
            count += math.prod(part.shape)
            return part

        self._places = _mapped(inputs, place)
        self._numbers = torch.zeros(count, device=device)
        self.fill(inputs)

    def fill(self, inputs: Any) -> None:
        """Put in other inputs of the same structure. Does not wait for a device that has their pictures."""
        leaves: list[Any] = []
        _mapped(inputs, leaves.append)
        numbers = [leaf.flatten() if isinstance(leaf, Tensor) else torch.tensor([float(leaf)]) for leaf in leaves if _travels(leaf)]
        self._numbers.copy_(torch.cat(numbers), non_blocking=True)
        for own, leaf in zip(self._own, (leaf for leaf in leaves if not _travels(leaf)), strict=True):
            own.copy_(leaf)

    def inputs(self) -> Any:
        """The inputs in this memory, with tensors on the device in place of numbers. Call it where a graph is captured."""

        def read(place: Tensor | _Part) -> Tensor:
            if isinstance(place, Tensor):
                return place
            there = self._numbers[place.start : place.start + math.prod(place.shape)].view(place.shape)
            return there.long() if place.whole else there

        return _mapped(self._places, read)


def structure(inputs: Any) -> Hashable:
    """What inputs have in common if one graph will do for them: all but the numbers."""
    if isinstance(inputs, Tensor):
        return inputs.dtype, inputs.shape, _travels(inputs)
    if isinstance(inputs, Camera):
        return inputs.width, inputs.height, inputs.near
    if isinstance(inputs, tuple):
        return tuple(map(structure, inputs))
    return type(inputs).__name__ if _is_number(inputs) else inputs


def _mapped(inputs: Any, change: Callable[[Any], Any]) -> Any:
    """``inputs`` with each tensor and number changed, in order."""
    if isinstance(inputs, Tensor | _Part) or _is_number(inputs):
        return change(inputs)
    if isinstance(inputs, Camera):
        return replace(inputs, K=change(inputs.K), cam_from_world=change(inputs.cam_from_world))
    if isinstance(inputs, tuple):
        parts = [_mapped(part, change) for part in inputs]
        return type(inputs)(*parts) if hasattr(inputs, "_fields") else tuple(parts)
    return inputs


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _travels(leaf: Any) -> bool:
    return not isinstance(leaf, Tensor) or (leaf.device.type == "cpu" and leaf.dtype == torch.float32)
