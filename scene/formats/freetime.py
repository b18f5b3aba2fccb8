"""Gaussians on straight paths as the PLY of FreeTimeGS (FTGS PLY, version 1): the layout of 3DGS, with a mean time, the logarithm of a
spread over time and a velocity for each. Time is normalised to [0, 1]."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch

from ...rasterizer import Gaussians
from .pieces import ALWAYS, Pieces
from .ply import LEAST_ALPHA, table_bytes

SHORTEST = 1e-4  # least spread that is written
BEYOND = ("time", "log_duration", *(f"velocity_{k}" for k in range(3)))


def freetime_bytes(pieces: Pieces, frames: int, comments: Sequence[str] = ()) -> bytes:
    """The file with ``pieces``, which have no windows here: their opacity alone says when they are there. ``frames``: of the clip."""
    look = pieces.gaussians
    assert look.sh is not None
    spreads = pieces.spreads.clamp(SHORTEST, ALWAYS)
    logits = torch.logit(look.opacities.double().clamp(LEAST_ALPHA / 2, 1 - 1e-6))
    said = {
        "ftgs_version": 1,
        "time_units": "normalized",
        "sh_degree": round(look.sh.shape[1] ** 0.5) - 1,
        "use_velocity": 1,
        "min_duration": SHORTEST,
        "opacity_floor": 0,
        "n_frames": frames,
    }
    beyond = dict(zip(BEYOND, (pieces.middles, spreads.log(), *pieces.velocities.unbind(1)), strict=True))
    quats, lines = torch.nn.functional.normalize(look.quats, dim=1), [f"{key} {value}" for key, value in said.items()]
    return table_bytes(look.means, look.sh, logits, look.scales.clamp(min=1e-20).log(), quats, beyond, [*lines, *comments])


def read_freetime(data: bytes) -> Pieces:
    """Inverse of `freetime_bytes`. Raises ValueError for another file."""
    head, found, body = data.partition(b"end_header\n")
    lines = head.decode("ascii", "replace").splitlines()
    names = [line.split()[-1] for line in lines if line.startswith("property float ")]
    if not found or not set(BEYOND) <= set(names) or "comment time_units normalized" not in lines:
        raise ValueError("this is no PLY file of FreeTimeGS")
    columns = dict(zip(names, torch.tensor(np.frombuffer(body, "<f4").reshape(-1, len(names)).astype(np.float32)).unbind(1)))

    def some(name: str, count: int) -> torch.Tensor:
        return torch.stack([columns[f"{name}_{k}"] for k in range(count)], 1)

    rest = sum(name.startswith("f_rest_") for name in names)
    sh = some("f_dc", 3)[:, None]
    if rest:
        sh = torch.cat([sh, some("f_rest", rest).reshape(-1, 3, rest // 3).transpose(1, 2)], 1)
    means = torch.stack([columns[k] for k in "xyz"], 1)
    look = Gaussians(means, some("rot", 4), some("scale", 3).exp(), torch.sigmoid(columns["opacity"]), sh=sh)
    always = torch.full((len(means),), torch.inf).double()
    return Pieces(look, some("velocity", 3).double(), columns["time"].double(), columns["log_duration"].double().exp(), -always, always)
