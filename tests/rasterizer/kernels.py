"""Whether the CPU kernels can be loaded here, and each instruction set of theirs in turn."""

from collections.abc import Iterator

import pytest

try:
    import e4dgs.rasterizer.cpu_backend as _cpu  # noqa: F401

    missing = ""
except ImportError as cause:
    missing = f"the CPU kernels cannot be imported: {cause}"

needs_cpu = pytest.mark.skipif(bool(missing), reason=missing)


@pytest.fixture(params=["avx512", "avx2", "baseline"])
def instruction_set(request: pytest.FixtureRequest) -> Iterator[str]:
    """The kernels of this instruction set are in use."""
    from e4dgs.rasterizer import _cpu

    best = _cpu.kernels()
    if not _cpu.select_kernels(request.param):
        pytest.skip(f"this processor or build has no {request.param}")
    yield request.param
    assert _cpu.select_kernels(best)
