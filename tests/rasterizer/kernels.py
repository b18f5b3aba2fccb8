"""Whether the CPU kernels can be loaded here; tests that need them carry `needs_cpu`."""

import pytest

try:
    import e4dgs.rasterizer.cpu_backend as _cpu  # noqa: F401

    missing = ""
except ImportError as cause:
    missing = f"the CPU kernels cannot be imported: {cause}"

needs_cpu = pytest.mark.skipif(bool(missing), reason=missing)
