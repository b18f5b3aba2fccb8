"""Fixtures of the rasterizer's tests: one thread unless a test sets its own, and each instruction set in turn."""

from rasterizer.conftest import one_thread  # noqa: F401
from rasterizer.kernels import instruction_set  # noqa: F401
