"""e4dgs: captures of moving scenes become 4D models that render any view at any time (Edge4DGS).

Importing this package costs nothing: every public name below is resolved on first use, so neither torch nor the
kernels are loaded by ``import e4dgs``.
"""

from importlib import import_module
from typing import Any

__version__ = "0.1.0"

_PUBLIC = {
    "Camera": ".rasterizer",
    "Convexes": ".rasterizer",
    "Gaussians": ".rasterizer",
    "rasterize": ".rasterizer",
    "Model": ".scene",
    "load": ".workflows.load",
    "load_gaussians": ".workflows.exports.load_gaussians",
    "recognise": ".stages.captures",
}

__all__ = ["__version__", *_PUBLIC]


def __getattr__(name: str) -> Any:
    if name in _PUBLIC:
        return getattr(import_module(_PUBLIC[name], __name__), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
