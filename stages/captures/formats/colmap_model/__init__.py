"""COLMAP models on disk: where they lie in a capture, and what their text and binary files hold."""

from __future__ import annotations

from .cloud import read_cloud
from .frames import place_frames
from .lenses import lens_of
from .places import Model, Place, choose, model_places
from .records import ImageRecord
from .rig import model_of_cameras
from .standing import extend_standing
from .twice import told_twice

__all__ = [
    "ImageRecord",
    "Model",
    "Place",
    "choose",
    "extend_standing",
    "lens_of",
    "model_of_cameras",
    "model_places",
    "place_frames",
    "read_cloud",
    "told_twice",
]
