"""The native code of benchmarks as a shared library, compiled for the instruction set in use from the checkout's sources."""

from __future__ import annotations

import ctypes
import os
import subprocess
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

from e4dgs.rasterizer import _cpu

HERE = Path(__file__).resolve().parent
KERNELS = HERE.parents[2] / "rasterizer"
# As CMakeLists.txt of rasterizer/cpu has them for the blending.
FLAGS = ("-std=c++20", "-O3", "-fno-math-errno", "-ffp-contract=off", "-fno-trapping-math", "-fopenmp", "-fPIC", "-shared")
INSTRUCTIONS = {
    "avx512": ("simd_avx512.h", "-march=x86-64-v4"),
    "avx2": ("simd_avx2.h", "-march=x86-64-v3"),
    "baseline": ("simd_portable.h",),
}


def library() -> ctypes.CDLL:
    """For the instruction set that the rasterizer uses now. Raises SystemExit with what the compiler says."""
    return _library(_cpu.kernels())


@cache
def _library(kernels: str) -> ctypes.CDLL:
    header, *machine = INSTRUCTIONS[kernels]
    compiler = (os.environ.get("CXX") or "c++").split()
    with TemporaryDirectory() as folder:
        target = Path(folder) / "benchmarks.so"
        command = [*compiler, *FLAGS, *machine, f"-I{KERNELS / 'cpu'}", f"-I{KERNELS / 'math'}", "-DE4DGS_ISA=e4dgs_limit"]
        command += [f'-DINSTRUCTIONS="{header}"', str(HERE / "limit.cpp"), str(HERE / "pairs.cpp"), "-o", str(target)]
        try:
            done = subprocess.run(command, capture_output=True, text=True)
        except OSError as cause:
            raise SystemExit(f"{compiler[0]} cannot be run ({cause}): these rows want a C++ compiler, see $CXX") from cause
        if done.returncode:
            raise SystemExit(f"{' '.join(command)} failed:\n{done.stderr[-3000:]}")
        return ctypes.CDLL(str(target))
