"""The inputs of a frame on the GPU, and the state that its forward pass computes and its backward pass needs."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from ..types import TILE, Camera, Convexes, Gaussians
from .runtime import current_stream

CAMERA_NUMBERS = 17  # fx fy cx cy, R, t, near


class View(NamedTuple):
    """What is rendered of a scene, on its device. camera: [17] float64: fx fy cx cy, R, t, near. background: [3] float32. drawn: [tiles]
    uint8, 0 where nothing is drawn; None: everything is."""

    camera: Tensor
    background: Tensor
    width: int
    height: int
    antialiased: bool
    drawn: Tensor | None


@dataclass(eq=False)
class Inputs:
    """The primitives' tensors are contiguous float32 on the view's device; the extras of both kinds have `channels` columns."""

    view: View
    gaussians: Gaussians
    convexes: Convexes
    channels: int

    @property
    def device(self) -> torch.device:
        return self.gaussians.means.device

    @property
    def width(self) -> int:
        return self.view.width

    @property
    def height(self) -> int:
        return self.view.height

    @property
    def n(self) -> int:
        return self.gaussians.means.shape[0]

    @property
    def m(self) -> int:
        return self.convexes.points.shape[0]

    @property
    def points(self) -> int:
        """K, or 0 if there are no convexes, because kernels without convexes are smaller."""
        return self.convexes.points.shape[1] if self.m else 0

    @property
    def tiles(self) -> int:
        return -(-self.width // TILE) * -(-self.height // TILE)

    def extras(self, kind: Gaussians | Convexes) -> Tensor | None:
        return kind.extras if self.channels else None


@dataclass(eq=False)
class State:
    """touched, transmittance and last are None if no backward pass follows.

    Each primitive that may be visible has a slot: the Gaussians first, then the convexes, in the order of their indices.

    gaussians [*, 64], convexes [*, *] uint8: the records of each kind. counts [*] int64: see `Count` in records.cuh.
    ids [slots] int32: each slot's primitive; slots [n + m] int32: each primitive's slot among those of its kind, -1 if it has none.
    begins [tiles + 1] int32, entries [pairs] int32: the lists of the tiles, as slots.
    pair [pairs] int32: the index of each entry's pair in order of depth, and lists: order [slots] int32, the slots from front to back, and
    ends [slots] int64, running sums of their numbers of pairs. Both are None unless sums must be deterministic.
    visible [n + m] uint8. touched [pairs] uint8: one bit for each region of the tile that blends the entry.
    transmittance [H, W] float32: behind each pixel's last layer; last [H, W] int32: each pixel's last entry.
    """

    gaussians: Tensor
    convexes: Tensor
    counts: Tensor
    ids: Tensor
    slots: Tensor
    begins: Tensor
    entries: Tensor
    pair: Tensor | None
    lists: tuple[Tensor, Tensor] | None
    visible: Tensor
    touched: Tensor | None = None
    transmittance: Tensor | None = None
    last: Tensor | None = None


def view_on(device: torch.device, camera: Camera, background: Tensor, antialiased: bool, tiles: Tensor | None) -> View:
    """The view through ``camera``, computed without waiting for ``device``. Camera and background on the CPU travel in one copy, which is
    kept for the next frames."""
    with torch.no_grad():
        if camera.K.device.type == "cpu" and background.device.type == "cpu":
            own, behind = _there(device, camera, background)
        else:
            own = _numbers(camera).to(device, non_blocking=True)
            behind = background.to(device, torch.float32, non_blocking=True).contiguous()
        drawn = None if tiles is None else tiles.to(device, torch.uint8, non_blocking=True).contiguous()
    return View(own, behind, camera.width, camera.height, antialiased, drawn)


_THERE: dict[tuple[torch.device, int, bytes], tuple[Tensor, Tensor]] = {}  # of the last views: `View.camera` and `View.background`
MOST_THERE = 1024


def _there(device: torch.device, camera: Camera, background: Tensor) -> tuple[Tensor, Tensor]:
    """`View.camera` and `View.background` on ``device``, copied on the current stream if they are not there yet."""
    K, pose = camera.K.tolist(), camera.cam_from_world.tolist()[:3]
    numbers = [K[0][0], K[1][1], K[0][2], K[1][2], *(x for row in pose for x in row[:3]), *(row[3] for row in pose), camera.near]
    packed = struct.pack(f"{CAMERA_NUMBERS}d3f", *numbers, *background.to(torch.float32).tolist())
    stream = current_stream(device.index) if device.type == "cuda" else 0
    found = _THERE.get((device, stream, packed))
    if found is None:
        if len(_THERE) >= MOST_THERE:
            _THERE.clear()
        with torch.inference_mode(False):
            there = torch.frombuffer(bytearray(packed), dtype=torch.uint8).to(device, non_blocking=True)
            found = there[: 8 * CAMERA_NUMBERS].view(torch.float64), there[8 * CAMERA_NUMBERS :].view(torch.float32)
        _THERE[device, stream, packed] = found
    return found


def _numbers(camera: Camera) -> Tensor:
    """`View.camera` on the camera's device."""
    K, pose = camera.K.double(), camera.cam_from_world.double()
    near = torch.full((1,), camera.near, dtype=torch.float64, device=K.device)
    intrinsics = torch.stack([K[0, 0], K[1, 1], K[0, 2], K[1, 2]])
    return torch.cat([intrinsics, pose[:3, :3].reshape(9), pose[:3, 3], near])


def looks_of(kind: Gaussians | Convexes) -> tuple[Tensor, int]:
    """(sh, its degree), or (colors, -1) if colours are given directly."""
    if kind.sh is None:
        assert kind.colors is not None
        return kind.colors, -1
    return kind.sh, {1: 0, 4: 1, 9: 2, 16: 3}[kind.sh.shape[1]]
