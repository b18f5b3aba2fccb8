"""Arrays of numbers as few bytes: rounded to steps, optionally as differences, split into planes of bytes that compress well."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

MOST_PLANES = 4  # bytes of a rounded number
MOST_NUMBERS = 1 << 28  # of an array
LEVELS = 2.0**31  # most steps between an array's least and greatest value


@dataclass(frozen=True)
class Coded:
    """One array: what the header says of it, and its bytes before compression.

    shape: (n, m, c). A number of column k is low[k] + step[k] q with an unsigned q of ``planes`` bytes. delta: stored is the difference
    from the row before (along n), as 2d for d >= 0 and -2d - 1 below. The bytes are ordered by column, then plane
    (least significant first), then n, then m. planes = 0: float32 instead, all bits.
    """

    name: str
    shape: tuple[int, int, int]
    low: tuple[float, ...]
    step: tuple[float, ...]
    planes: int
    delta: bool
    data: bytes

    @property
    def header(self) -> dict[str, Any]:
        """JSON of `description_of`."""
        said: dict[str, Any] = {"name": self.name, "shape": list(self.shape), "planes": self.planes}
        return said if not self.planes else said | {"low": list(self.low), "step": list(self.step), "delta": self.delta}


def encode(name: str, values: np.ndarray, step: float | np.ndarray | None, delta: bool = False) -> Coded:
    """``values`` [n, c] or [n, m, c] in multiples of ``step`` (a number or [c], > 0), so each is wrong by half a step at most; None keeps
    float32. A range of more than `LEVELS` steps makes the steps larger. Raises ValueError for a value that is not finite."""
    values = np.asarray(values, np.float64)
    values = values[:, None] if values.ndim == 2 else values
    n, m, c = values.shape
    if not np.isfinite(values).all():
        raise ValueError(f"{name}: a value is not finite")
    columns = values.transpose(2, 0, 1)
    if step is None:
        data = columns.astype("<f4").reshape(c, n * m, 1).view(np.uint8).transpose(0, 2, 1)
        return Coded(name, (n, m, c), (), (), 0, False, data.tobytes())
    low = columns.reshape(c, -1).min(1, initial=np.inf) if n * m else np.zeros(c)
    span = columns.reshape(c, -1).max(1, initial=-np.inf) - low if n * m else np.zeros(c)
    steps = np.maximum(np.broadcast_to(np.asarray(step, np.float64), (c,)), span / LEVELS)
    whole = np.rint((columns - low[:, None, None]) / steps[:, None, None]).astype(np.int64)
    if delta:
        whole = np.diff(whole, axis=1, prepend=0)
        whole = np.where(whole < 0, -2 * whole - 1, 2 * whole)
    planes = max(1, math.ceil(int(whole.max(initial=0)).bit_length() / 8))
    split = whole.astype("<u8").reshape(c, n * m, 1).view(np.uint8)[..., :planes].transpose(0, 2, 1)
    return Coded(name, (n, m, c), tuple(map(float, low)), tuple(map(float, steps)), planes, delta, split.tobytes())


def decode(said: Coded) -> np.ndarray:
    """[n, m, c] float64; inverse of `encode` up to rounding."""
    n, m, c = said.shape
    if not said.planes:
        raw = np.frombuffer(said.data, np.uint8).reshape(c, 4, n * m).transpose(0, 2, 1)
        columns = np.ascontiguousarray(raw).view("<f4").astype(np.float64).reshape(c, n, m)
        return columns.transpose(1, 2, 0)
    split = np.frombuffer(said.data, np.uint8).reshape(c, said.planes, n, m)
    whole = np.zeros((c, n, m), np.int64)
    for k in range(said.planes):
        whole |= split[:, k].astype(np.int64) << (8 * k)
    if said.delta:
        whole = np.where(whole & 1, -(whole + 1 >> 1), whole >> 1).cumsum(1)
    columns = np.asarray(said.low)[:, None, None] + np.asarray(said.step)[:, None, None] * whole
    return columns.transpose(1, 2, 0)


def description_of(said: Any) -> Coded:
    """The `Coded` without data that a file's header describes. Raises ValueError if it describes none."""
    if not isinstance(said, dict) or not isinstance(said.get("name"), str):
        raise ValueError("an array has no name")
    name, shape, planes = said["name"], said.get("shape"), said.get("planes")
    if (
        not isinstance(shape, list)
        or len(shape) != 3
        or not all(type(k) is int and k >= 0 for k in shape)
        or math.prod(shape) > MOST_NUMBERS
    ):
        raise ValueError(f"{name}: its shape is {shape!r}")
    if type(planes) is not int or not 0 <= planes <= MOST_PLANES:
        raise ValueError(f"{name}: its numbers have {planes!r} bytes")
    low, step = (said.get(key, []) for key in ("low", "step"))
    wanted = shape[2] if planes else 0
    for column in (low, step):
        if not isinstance(column, list) or len(column) != wanted or not all(type(x) in (int, float) and math.isfinite(x) for x in column):
            raise ValueError(f"{name}: its low and step are not {wanted} numbers")
    return Coded(name, (shape[0], shape[1], shape[2]), tuple(low), tuple(step), planes, said.get("delta") is True, b"")


def bytes_of(said: Coded) -> int:
    """How many bytes an array so described has before compression."""
    return math.prod(said.shape) * (said.planes or 4)
