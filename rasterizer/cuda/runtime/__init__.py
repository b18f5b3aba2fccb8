"""Runs kernels on a GPU: compiles programs on the machine that uses them, keeps them on disk, and launches them on torch's stream.

Internal to this package, and independent of any particular kernel. `rasterizer/cuda` and `scene/cuda` describe their kernels as programs
and launch them through the names exported here. The other modules in this folder are private.
"""

from .arguments import Argument
from .available import describe, why_not
from .late import read_later
from .launcher import Launcher, launcher_for, launching, warm_up
from .program import Program
from .stream import current_stream

__all__ = [
    "Argument",
    "Launcher",
    "Program",
    "current_stream",
    "describe",
    "launcher_for",
    "launching",
    "read_later",
    "warm_up",
    "why_not",
]
