"""The size of pictures that is usual on a device, and is taken unless the user says otherwise."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class Usual:
    """size: px, longest side. device: where it is usual, for people."""

    size: int
    device: str


USUAL: Mapping[str, Usual] = {"cpu": Usual(960, "a CPU"), "cuda": Usual(1600, "a GPU")}  # 3DGS trains at 1,600 px at most


def told_size(usual: Usual, stored: tuple[int, int], taken: tuple[int, int]) -> str:
    return (
        f"pictures of {stored[0]}x{stored[1]} are scaled to {taken[0]}x{taken[1]}, as is usual on {usual.device}; "
        f"--set frames.max_size={max(stored)} keeps their size"
    )
