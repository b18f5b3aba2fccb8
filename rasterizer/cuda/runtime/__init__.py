"""What runs kernels on a GPU: programs are compiled where they are used, kept on disk, and launched on torch's stream.

Ours alone: it knows no kernel. `rasterizer/cuda` and `scene/cuda` describe their kernels as programs and launch them through this face;
the files behind it are nobody else's business.
"""

from .arguments import Argument
from .available import describe, why_not
from .launcher import Launcher, launcher_for, launching, warm_up
from .program import Program

__all__ = ["Argument", "Launcher", "Program", "describe", "launcher_for", "launching", "warm_up", "why_not"]
