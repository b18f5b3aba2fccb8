"""Kernels of this folder, and short ways to launch them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import torch

from .emulator import Emulator

KERNELS = Path(__file__).resolve().parent / "kernels"
SEEDS = range(6)


@dataclass(frozen=True)
class Program:
    source: Path
    defines: tuple[tuple[str, int], ...] = ()
    includes: tuple[Path, ...] = ()


def kernels_of(name: str, **defines: int) -> Program:
    return Program(KERNELS / f"{name}.cu", tuple(defines.items()))


def launch(program: Program, kernel: str, blocks: int, threads: int, *arguments: object, seed: int = 0, **options: object) -> None:
    Emulator(seed, **options).launch(program, kernel, blocks, threads, *arguments)


def ints(*shape: int, fill: int = 0) -> torch.Tensor:
    return torch.full(shape, fill, dtype=torch.int32)
