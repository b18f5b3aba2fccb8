"""CUDA kernels on the CPU, so that they can be tested on machines without a GPU.

    from simt import Emulator, needs_compiler

    emulator = Emulator(seed=1)  # the order in which threads run; 0 is their own
    emulator.launch(program, "blend_forward", blocks, threads, image, None, c_int32(width))

A kernel's source is compiled for the host with `simt.h` in CUDA's place. Each thread of a block is a fiber, which runs until it has
to wait for others, so what needs a barrier and has none shows under some seed; with `flags=RACES` it shows under any. `flags=CHECKED`
finds indices out of bounds, misaligned vectors and overflows.

The emulator is stricter than hardware. Lanes that are to meet must come to the same collective, with the same mask, on the same line
of the source, and none that a mask names may have ended; the threads of a block that have not ended must come to the same line's
__syncthreads. Shared memory that nobody wrote is NaN, as is what a lane gets from one that was not asked. What is wrong is a SimtError
that names kernel, block, warp, lanes and lines.

It does not know time, caches, approximate instructions (exp2f and its like are the host's), dynamic shared memory, widths of shuffles
other than 32, or grids of more than one dimension. Blocks run one after another: one that waits for a later one waits until `seconds` are
over. It imports nothing of the package under test.
"""

from .compiler import CHECKED, RACES, compile, needs_compiler, why_not
from .emulator import Emulator
from .error import SimtError

__all__ = ["CHECKED", "RACES", "Emulator", "SimtError", "compile", "needs_compiler", "why_not"]
