"""Tests of meshes are skipped where Open3D's wheel lacks a library of the system."""

import pytest


def problem() -> str:
    """Why Open3D cannot be loaded; "" where it can."""
    try:
        import open3d  # noqa: F401
    except ImportError as error:
        return str(error)
    return ""


needs_open3d = pytest.mark.skipif(bool(problem()), reason=f"Open3D cannot be loaded: {problem()}; apt-get install libusb-1.0-0")
