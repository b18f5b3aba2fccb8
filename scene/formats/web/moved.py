"""The motions of a web scene at one time. `workflows/player/scripts/motion.js` and the shaders compute the same."""

from __future__ import annotations

import math
from typing import Any, Protocol

import numpy as np
import torch
from torch import Tensor

from ...motion.lifetimes.at_frame import turned_by
from ...rotation import compose, rotate

BEYOND = 3.0  # spans; a life's drift and spin are given for so far from its middle, or for the whole clip if that is shorter


class Rows(Protocol):
    """What is read of a `WebScene`."""

    header: dict[str, Any]
    arrays: dict[str, np.ndarray]

    def _rows(self, name: str) -> Tensor: ...


def reach_of(log_spans: Tensor, frames: int) -> Tensor:
    """[n] frames over which a life's drift and spin are given: `BEYOND` spans, at most the whole clip, at least a frame."""
    return (BEYOND * log_spans.clamp(max=math.log(1e6)).exp()).clamp(1.0, max(float(frames), 1.0))


def lived(
    scene: Rows, kind: str, frame: float, points: Tensor, turns: Tensor | None, opacities: Tensor
) -> tuple[Tensor, Tensor | None, Tensor]:
    """The moving ones of ``kind`` "g" or "c" at fractional ``frame``: ``points`` [n, K, 3], or means [n, 3] for Gaussians, which have
    ``turns`` [n, 4]; opacities [n]."""
    life, drift, spin = (scene._rows(f"{kind}_{name}") for name in ("life", "drift", "spin"))
    age = frame - life[:, 0]
    share = (age / reach_of(life[:, 1], scene.header["frames"]))[:, None]
    turned = turned_by(spin * share)
    moved = points + (drift * share)[:, None]
    if points.shape[1] > 1:
        arms = points - points.mean(1, keepdim=True)
        corners = turned.repeat_interleave(points.shape[1], 0)
        moved = moved + rotate(corners, arms.reshape(-1, 3)).reshape(arms.shape) - arms
    present = torch.exp(-0.5 * (age * torch.exp(-life[:, 1])).square())
    return moved if turns is None else moved[:, 0], None if turns is None else compose(turned, turns), opacities * present


def on_paths(scene: Rows, name: str, t: float) -> Tensor:
    """[m, c] of an array of keys [keys, m, c] at ``t``, linear between them."""
    keys = torch.tensor(scene.arrays[name], dtype=torch.float32)
    place = t * (len(keys) - 1)
    low = min(int(place), max(len(keys) - 2, 0))
    return keys[low] + (place - low) * (keys[min(low + 1, len(keys) - 1)] - keys[low])


def poses_of(scene: Rows, t: float) -> Tensor:
    """[B, 7] turn (unit, w x y z) and shift of each node at ``t``."""
    modes = torch.tensor(scene.arrays["node_modes"], dtype=torch.float32)
    pose = torch.einsum("r,rbo->bo", on_paths(scene, "node_courses", t)[0], modes)
    turn = pose[:, :4] + torch.tensor([1.0, 0, 0, 0])
    return torch.cat([turn / turn.norm(dim=1, keepdim=True).clamp(min=1e-6), pose[:, 4:]], 1)


def on_nodes(scene: Rows, kind: str, t: float, points: Tensor, turns: Tensor | None) -> tuple[Tensor, Tensor | None]:
    """``points`` [n, 3], and ``turns`` [n, 4] of Gaussians, as the nodes carry them at ``t``."""
    pose, homes = poses_of(scene, t), scene._rows("node_homes")
    links = torch.tensor(scene.arrays[f"{kind}_links"]).reshape(-1, 4).long()
    first = torch.tensor(scene.arrays[f"{kind}_weights"], dtype=torch.float32).reshape(-1, 3)
    weights = torch.cat([first, 1 - first.sum(1, keepdim=True)], 1)
    moved, blended = torch.zeros_like(points), torch.zeros(len(points), 4)
    for k in range(links.shape[1]):
        node, weight = links[:, k], weights[:, k : k + 1]
        turn = pose[node, :4]
        moved = moved + weight * (rotate(turn, points - homes[node]) + homes[node] + pose[node, 4:])
        side = torch.where((turn * pose[links[:, 0], :4]).sum(1, keepdim=True) < 0, -1.0, 1.0)  # q and -q are one rotation
        blended = blended + weight * side * turn
    if turns is None:
        return moved, None
    return moved, compose(blended / blended.norm(dim=1, keepdim=True).clamp(min=1e-6), turns)
