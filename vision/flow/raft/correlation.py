"""How well each feature of one picture matches the features of the other around the point where its flow leads, at four scales
(RAFT, section 3.2)."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional as F

from ... import _kernels  # type: ignore[attr-defined]
from .architecture import LEVELS

CHUNK_BYTES = 128 << 20  # of correlations held at once on the path without the kernel


class Correlation:
    """Correlations of first [B, C, h, w] with second [B, C, h, w], never all held in memory at once.

    All of them, hw by hw, would take 4 GiB for a picture of 1920x1080. In float32 on the CPU, a kernel computes only those that a window
    touches (100 of about 32,000 per level). Otherwise blocks of rows are multiplied and sampled. Both agree up to rounding.
    """

    def __init__(self, first: Tensor, second: Tensor, radius: int, kernel: bool | None = None) -> None:
        if min(first.shape[2:]) < 2 ** (LEVELS - 1):
            raise ValueError(f"features must be at least {2 ** (LEVELS - 1)} a side, got {list(first.shape[2:])}")
        self.radius, self.shape = radius, first.shape
        self.kernel = first.device.type == "cpu" and first.dtype == torch.float32 if kernel is None else kernel
        first = first / first.shape[1] ** 0.5
        levels = [second]
        for _ in range(LEVELS - 1):  # the mean of correlations equals the correlation with the mean
            levels.append(F.avg_pool2d(levels[-1], 2))
        self.first = first.flatten(2).transpose(1, 2).contiguous()  # [B, hw, C]
        self.levels = [level.permute(0, 2, 3, 1).contiguous() for level in levels]  # [B, h, w, C]

    def __call__(self, at: Tensor) -> Tensor:
        """Windows [B, 4 (2 radius + 1)^2, h, w] around the positions `at` [B, 2, h, w] (x, y in features of the second; zeros where not
        finite), bilinear, zero outside. Within a window the offset in x varies slowest."""
        b, _, h, w = self.shape
        places = at.permute(0, 2, 3, 1).reshape(b, h * w, 2)
        side = 2 * self.radius + 1
        out = self.first.new_empty(b, h * w, LEVELS * side * side)
        for i in range(b):
            if self.kernel:
                _kernels.correlate(
                    self.first[i], [level[i] for level in self.levels], places[i].contiguous(), self.radius, out[i], torch.get_num_threads()
                )
            else:
                rows = max(1, CHUNK_BYTES // (h * w * 4))
                for begin in range(0, h * w, rows):
                    self._multiplied(i, slice(begin, begin + rows), places[i, begin : begin + rows], out)
        return out.transpose(1, 2).reshape(b, -1, h, w)

    def _multiplied(self, i: int, rows: slice, places: Tensor, out: Tensor) -> None:
        side = 2 * self.radius + 1
        steps = torch.arange(-self.radius, self.radius + 1, device=places.device, dtype=torch.float32)
        offsets = torch.stack(torch.meshgrid(steps, steps, indexing="ij"), -1)  # [side, side, 2], x slowest
        for k, level in enumerate(self.levels):
            h, w, c = level.shape[1:]
            products = (self.first[i, rows] @ level[i].reshape(h * w, c).T).view(-1, 1, h, w)
            grid = places.float()[:, None, None] / 2**k + offsets
            size = torch.tensor([w, h], device=grid.device)
            found = F.grid_sample(products.float(), (2 * grid + 1) / size - 1, align_corners=False)  # True divides by zero for size 1
            out[i, rows, k * side * side : (k + 1) * side * side] = found.flatten(1).nan_to_num(0.0).to(out.dtype)
