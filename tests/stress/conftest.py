"""Fixtures of the rasterizer's tests: one thread unless a test sets its own, and each instruction set in turn."""

from rasterizer.conftest import instruction_set, one_thread  # noqa: F401
