"""Launches of kernels on the CPU, in the order of threads that a seed chooses."""

from __future__ import annotations

import ctypes
import threading
from functools import cache
from pathlib import Path
from typing import NamedTuple

from torch import Tensor

from .arguments import Kernel, address
from .compiler import Program, compile
from .error import SimtError
from .places import with_names

# A library has one block, and the process one set of handlers of faults.
ONE_AT_A_TIME = threading.Lock()


class Library:
    """A compiled program, loaded."""

    def __init__(self, path: Path) -> None:
        self.path = path
        native = ctypes.CDLL(str(path))
        self._launch = native.simt_launch
        self._launch.restype = ctypes.c_char_p
        integers = (ctypes.c_int, ctypes.c_uint32, ctypes.c_uint32)
        self._launch.argtypes = [*integers, ctypes.c_void_p, ctypes.c_uint64, ctypes.c_double]
        native.simt_kernels.restype = ctypes.POINTER(Kernel)
        n = ctypes.c_int()
        table = native.simt_kernels(ctypes.byref(n))
        self.kernels = {table[i].name.decode(): (i, table[i]) for i in range(n.value)}

    def launch(self, index: int, blocks: int, threads: int, values: list[ctypes._SimpleCData], seed: int, seconds: float) -> str:
        """What went wrong, or nothing."""
        pointers = (ctypes.c_void_p * (len(values) + 1))(*(ctypes.addressof(value) for value in values))
        with ONE_AT_A_TIME:
            said = self._launch(index, blocks, threads, pointers, seed, seconds)
            return with_names(said.decode(), self.path) if said else ""


class Compiled(NamedTuple):
    """A program by its parts, whatever object it was, and the flags it is compiled with."""

    source: Path
    defines: tuple[tuple[str, int], ...]
    includes: tuple[Path, ...]
    flags: tuple[str, ...]


@cache
def library(program: Compiled) -> Library:
    """Once a process: edits of a source count from the next one on."""
    return Library(compile(program, program.flags))


class Emulator:
    """Runs kernels as a GPU would, block after block.

    seed: chooses the order of blocks, and of threads between two meetings. With 0 it is their own, one warp after another.
    flags: given to the compiler after its usual ones.
    seconds: of processor time that a launch may take.
    """

    def __init__(self, seed: int = 0, flags: tuple[str, ...] = (), seconds: float = 60.0) -> None:
        self.seed, self.flags, self.seconds = seed, flags, seconds

    def compile(self, program: Program) -> Path:
        """The shared library of a program, to have it ahead of its first launch."""
        return self._library(program).path

    def launch(self, program: Program, kernel: str, blocks: int, threads: int, *arguments: Tensor | ctypes._SimpleCData | None) -> None:
        """Run `blocks` blocks of `threads` threads, and return when they have ended; no blocks, no launch.

        An argument is a contiguous CPU tensor or None for a pointer, a ctypes number for a scalar. Raises SimtError where they are
        not what the kernel takes, and where threads deadlock, diverge, or read and write what is not theirs; what they wrote until
        then stays written.
        """
        found = self._library(program)
        where = f"{program.source.name}: {kernel}"
        if kernel not in found.kernels:
            raise SimtError(f"{where}: there is no such kernel, only {', '.join(found.kernels)}")
        index, table = found.kernels[kernel]
        if not 0 <= blocks < 2**31:
            raise SimtError(f"{where}: a grid has at most 2^31 - 1 blocks, not {blocks}")
        if not 1 <= threads <= table.bound:
            raise SimtError(f"{where}: a block of this kernel has 1 to {table.bound} threads, not {threads}")
        parameters = table.parameters[: table.n_parameters]
        if len(arguments) != len(parameters):
            names = ", ".join(parameter.name.decode() for parameter in parameters)
            raise SimtError(f"{where}: takes {len(parameters)} arguments ({names}), not {len(arguments)}")
        try:
            values = [address(*both) for both in zip(parameters, arguments)]
        except SimtError as error:
            raise SimtError(f"{where}: {error}") from None
        said = found.launch(index, blocks, threads, values, self.seed, self.seconds) if blocks else ""
        if said:
            raise SimtError(f"{where}: {said}")

    def _library(self, program: Program) -> Library:
        return library(Compiled(program.source, program.defines, program.includes, self.flags))
