"""Renders of one model as CUDA graphs: the host would take several times as long as the GPU."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from threading import RLock

import torch
from torch import Tensor

from ...rasterizer import Camera, Frame
from ...rasterizer.uniform import FAR_CAMERA
from ...rasterizer.validate import check_camera
from .graph import Graph, unchanged

Draw = Callable[[Camera, float | Tensor, Tensor], Frame]
FIELDS = ("color", "alpha", "depth", "extras", "visible_gaussians", "visible_convexes")
MOST_SIZES = 4  # of images, of which graphs are kept


class RenderGraph:
    """``draw`` for cameras of the size and near plane of ``camera``, at any time and in front of any background."""

    def __init__(self, draw: Draw, device: torch.device, camera: Camera, time: float, background: Tensor) -> None:
        self._numbers = torch.zeros(9 + 16 + 1 + 3, device=device)
        K, pose, at, behind = self._numbers.split([9, 16, 1, 3])
        there = Camera(K.view(3, 3), pose.view(4, 4), camera.width, camera.height, camera.near)

        def compute() -> list[Tensor | None]:
            frame = draw(there, at[0], behind)
            return [getattr(frame, name) for name in FIELDS]

        self._put(camera, time, background)
        self._graph = Graph(compute, device, None)

    def _put(self, camera: Camera, time: float, background: Tensor) -> None:
        numbers = camera.K.flatten(), camera.cam_from_world.flatten(), torch.tensor([time]), background
        self._numbers.copy_(torch.cat([part.detach().to("cpu", torch.float32) for part in numbers]), non_blocking=True)

    def __call__(self, camera: Camera, time: float, background: Tensor) -> Frame | None:
        """The frame; None if it has more pairs of a tile and a primitive than the graph has room for. Waits for the device."""
        self._put(camera, time, background)
        self._graph.replay()
        found = Frame(*(part.clone() for part in self._graph.results if part is not None))
        return None if any(frame.overflowed() for frame in self._graph.frames) else found


class Renders:
    """Renders a model: the first frame of a size as usual, the second one is captured, later ones are replays. Threads take turns."""

    def __init__(self) -> None:
        self._known: dict[tuple[int, int, float], RenderGraph | None] = {}
        self._memory: tuple[object, ...] = ()
        self._usable, self._one_at_a_time = torch.backends.cuda.is_built(), RLock()

    def __call__(
        self, draw: Draw, memory: tuple[object, ...], device: torch.device, camera: Camera, time: float, background: Tensor
    ) -> Frame:
        """``draw`` on ``device``, without gradients. memory: what it reads; where something else is in its place, graphs are made again."""
        values = check_camera(camera)
        numbers = [0.0] if values is None else [row[3] for row in values[1][:3]]  # of their length is the distance from the origin
        far = math.hypot(*numbers) >= FAR_CAMERA or not all(map(math.isfinite, background.tolist()))
        if not self._usable or camera.K.device.type != "cpu" or far:
            return draw(camera, time, background)
        with self._one_at_a_time:
            if not unchanged(memory, self._memory):
                self._known.clear()
                self._memory = memory
            size = camera.width, camera.height, camera.near
            if size not in self._known:
                while len(self._known) >= MOST_SIZES:
                    del self._known[next(iter(self._known))]
                self._known[size] = None
                return draw(camera, time, background)
            known = self._known[size]
            try:
                if known is None:
                    known = self._known[size] = RenderGraph(draw, device, camera, time, background)
                found = known(camera, time, background)
            except RuntimeError as cause:
                self._usable, found = False, None
                warnings.warn(f"renders are not replayed as CUDA graphs: {str(cause).splitlines()[0]}", stacklevel=2)
            if found is None:
                del self._known[size]  # the next graph has more room
                return draw(camera, time, background)
            return found
