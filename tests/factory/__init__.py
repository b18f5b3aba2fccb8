"""Synthetic captures with exact ground truth: one options object makes a scene, a ray caster renders it, writers lay it out.

    from factory import Options, make, render, optical_flow, write_dnerf

    synthetic = make(Options(backdrop="room", rig="path", times=8))
    view = synthetic.views[0]
    truth = render(synthetic.scene, view.camera, view.time)      # image, depth, object of every pixel
    flow = optical_flow(synthetic.scene, view.camera, 0.0, 0.1)  # px, with a visibility mask

Everything is float64 numpy, has no state, and gives the same bits on every run. The world is metric-free and z points up;
cameras are OpenCV (x right, y down, z forward), pixel centres at +0.5. It imports nothing of the package under test, so
that a mistake there cannot hide itself here.
"""

from .camera import Camera, look_at
from .flow import Flow, optical_flow
from .motion import Motion
from .render import Truth, render, to_uint8
from .scene import Object, Options, Scene, Synthetic, View, make
from .shapes import Box, Sphere
from .textures import Cells, Checker, Stripes
from .writers import (
    Capture,
    surface_points,
    write_colmap,
    write_dnerf,
    write_images,
    write_n3v,
    write_nerfies,
    write_nerfstudio,
    write_panoptic,
    write_video,
    write_videos,
)

__all__ = [
    "Box",
    "Camera",
    "Capture",
    "Cells",
    "Checker",
    "Flow",
    "Motion",
    "Object",
    "Options",
    "Scene",
    "Sphere",
    "Stripes",
    "Synthetic",
    "Truth",
    "View",
    "look_at",
    "make",
    "optical_flow",
    "render",
    "surface_points",
    "to_uint8",
    "write_colmap",
    "write_dnerf",
    "write_images",
    "write_n3v",
    "write_nerfies",
    "write_nerfstudio",
    "write_panoptic",
    "write_video",
    "write_videos",
]
