"""RAFT, Teed and Deng 2020: optical flow, refined step by step by looking up how well it matches.

This is our own implementation; it runs the published weights.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional as F

from .architecture import LEVELS, STRIDE, Architecture
from .correlation import Correlation
from .layers import context_terms, encode, enlarge, update
from .weights import folded, read_weights

MINIMUM_SIDE = STRIDE * 2 ** (LEVELS - 1)  # px; smaller pictures are padded to it


@dataclass(frozen=True)
class Features:
    """What RAFT computes from one picture alone: `matched`, `hidden`, `context` [1, C, h, w] of the padded picture. `size`: height and
    width before padding. (`top`, `left`): where the first pixel lies after padding."""

    matched: Tensor
    hidden: Tensor
    context: Tensor
    size: tuple[int, int]
    top: int
    left: int


class Raft:
    """A network with its weights, on one device. `encode` each picture once, then `match` any two of the same size.

    state: tensors as `architecture.expected_shapes` lists them. half: computes features and updates in half precision, for GPUs.
    """

    def __init__(self, state: Mapping[str, Tensor], architecture: Architecture, device: str = "cpu", half: bool = False) -> None:
        self.architecture = architecture
        self.device, self.dtype = torch.device(device), torch.float16 if half else torch.float32
        self._state = {name: value.to(self.device, self.dtype) for name, value in folded(state, architecture).items()}

    @classmethod
    def load(cls, path: Path, device: str = "cpu", half: bool = False) -> Raft:
        """A network with the weights of a file; see `read_weights`, which raises ValueError with the file's name if it cannot be used."""
        return cls(*read_weights(path), device=device, half=half)

    @torch.inference_mode()
    def encode(self, picture: np.ndarray) -> Features:
        """Features of ``picture``, uint8 [H, W, 3] RGB of any size. Raises ValueError for another shape or dtype."""
        if picture.ndim != 3 or picture.shape[2] != 3 or picture.dtype != np.uint8 or picture.size == 0:
            raise ValueError(f"picture: expected uint8 [H, W, 3] with H, W > 0, got {picture.dtype} {list(picture.shape)}")
        height, width = picture.shape[:2]
        down, right = (max(MINIMUM_SIDE, -(-side // STRIDE) * STRIDE) - side for side in (height, width))
        x = torch.from_numpy(np.array(picture)).to(self.device).permute(2, 0, 1)[None].float() * (2 / 255) - 1
        x = F.pad(x, (right // 2, right - right // 2, down // 2, down - down // 2), mode="replicate").to(self.dtype)
        matched = encode(self._state, "fnet", self.architecture, x)
        both = encode(self._state, "cnet", self.architecture, x)
        hidden, context = both.split([self.architecture.state, self.architecture.context], 1)
        return Features(matched, hidden.tanh(), context.relu(), (height, width), down // 2, right // 2)

    @torch.inference_mode()
    def match(self, first: Features, second: Features, iterations: int = 12, tolerance: float = 0.0) -> tuple[np.ndarray, int]:
        """Flow [H, W, 2] float32 px from first to second (pixel (x, y) of first is at (x+u, y+v) in second), and the number of steps taken.

        iterations: the most steps. tolerance: px; it stops after a step whose root mean square change of the flow is smaller.
        """
        if first.size != second.size:
            raise ValueError(f"pictures differ in size: {list(first.size)} and {list(second.size)}")
        if iterations < 1:
            raise ValueError("iterations: expected at least 1")
        a = self.architecture
        correlation = Correlation(first.matched, second.matched, a.radius)
        _, _, h, w = first.matched.shape
        y, x = torch.meshgrid(torch.arange(h, device=self.device), torch.arange(w, device=self.device), indexing="ij")
        here = torch.stack([x, y])[None].float()
        flow, hidden, steps = torch.zeros_like(here), first.hidden, 0
        terms = context_terms(self._state, a, first.context)
        while steps < iterations:
            steps += 1
            found = correlation(here + flow)
            hidden, change = update(self._state, a, hidden, terms, found, flow.to(self.dtype))
            flow = flow + change.float()
            if tolerance > 0 and STRIDE * float(change.float().square().sum(1).mean().sqrt()) < tolerance:
                break
        fine = enlarge(self._state, a, hidden, flow.to(self.dtype))[0].float()
        height, width = first.size
        cut = fine[:, first.top : first.top + height, first.left : first.left + width]
        return np.ascontiguousarray(cut.permute(1, 2, 0).cpu().numpy()), steps
