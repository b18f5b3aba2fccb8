"""The 4D model: Gaussians, convexes, motion, losses, density control and the training loop. See DESIGN.md in this folder.

Names resolve on first use: importing `e4dgs.scene` does not import torch.
"""

from importlib import import_module
from typing import Any

_PUBLIC = {
    "Model": ".model",
    "GaussianSet": ".primitives",
    "ConvexSet": ".primitives",
    "DeformationField": ".motion.planes.field",
    "ControlNodes": ".motion.nodes.control_nodes",
    "Motion": ".motion.interface",
    "Trainer": ".training.trainer",
    "Views": ".views",
}

__all__ = sorted(_PUBLIC)


def __getattr__(name: str) -> Any:
    if name in _PUBLIC:
        return getattr(import_module(_PUBLIC[name], __name__), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
