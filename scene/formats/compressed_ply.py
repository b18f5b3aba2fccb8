"""Gaussians of one moment as PlayCanvas' compressed PLY file, which SuperSplat and its web viewers read.

The layout follows PlayCanvas' user manual: chunks of 256 Gaussians, each with the bounds of its positions, log scales and colours. Values
are quantised within these bounds to 10 or 11 bits (colours to 8).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...rasterizer import Gaussians
from ..primitives import SH_C0
from .ply import seen
from .smallest_three import LARGEST, smallest_three

CHUNK = 256
SH_REACH = 4.0  # SH coefficients after the constant one have 8 bits for -4 to 4
BOXES = [f"{end}_{of}" for group in (("x", "y", "z"), ("scale_x", "scale_y", "scale_z"), "rgb") for end in ("min", "max") for of in group]


def compressed_ply_bytes(gaussians: Gaussians, comments: Sequence[str] = ()) -> tuple[bytes, int]:
    """The file with the visible ones among ``gaussians`` (with sh), and their number. comments: lines of its header. Neighbours are stored
    one after another, so that the bounds are tight. SH is ordered by channel, then coefficient, as in the PLY file of 3DGS."""
    shown = seen(gaussians)
    assert shown.sh is not None
    means, quats, sh = (a.detach().cpu().double().numpy() for a in (shown.means, shown.quats, shown.sh))
    logs, opacities = shown.scales.log().detach().cpu().double().numpy(), shown.opacities.clamp(0, 1).detach().cpu().double().numpy()
    order = np.argsort(morton(means), kind="stable")
    values = np.concatenate([means, logs, 0.5 + SH_C0 * sh[:, 0]], 1)[order]
    rows, chunks = len(order), -(-len(order) // CHUNK)
    of_chunk = np.arange(rows) // CHUNK
    starts = np.arange(chunks) * CHUNK
    low = np.minimum.reduceat(values, starts).astype("<f4") if rows else np.zeros((0, 9), "<f4")
    high = np.maximum.reduceat(values, starts).astype("<f4") if rows else np.zeros((0, 9), "<f4")
    size = np.where(high > low, high.astype(float) - low, 1.0)
    place = (values - low[of_chunk]) / size[of_chunk]
    left_out, others = smallest_three(quats[order])
    packed = np.zeros((rows, 4), "<u4")
    packed[:, 0] = _packed(place[:, 0:3], (11, 10, 11))
    packed[:, 1] = left_out.astype(np.uint32) << np.uint32(30) | _packed(others / (2 * LARGEST) + 0.5, (10, 10, 10))
    packed[:, 2] = _packed(place[:, 3:6], (11, 10, 11))
    packed[:, 3] = _packed(np.concatenate([place[:, 6:9], opacities[order, None]], 1), (8, 8, 8, 8))
    rest = sh[order, 1:].transpose(0, 2, 1).reshape(rows, 3 * (sh.shape[1] - 1))
    coded = np.floor((rest / (2 * SH_REACH) + 0.5) * 256).clip(0, 255).astype("u1")  # readers use the middle of each step
    boxes = np.concatenate([part for k in (0, 3, 6) for part in (low[:, k : k + 3], high[:, k : k + 3])], 1)
    header = ["ply", "format binary_little_endian 1.0", *(f"comment {line}" for line in comments)]
    header += [f"element chunk {chunks}", *(f"property float {n}" for n in BOXES)]
    header += [f"element vertex {rows}", *(f"property uint packed_{n}" for n in ("position", "rotation", "scale", "color"))]
    if rest.shape[1]:
        header += [f"element sh {rows}", *(f"property uchar f_rest_{k}" for k in range(rest.shape[1]))]
    text = "\n".join([*header, "end_header"]) + "\n"
    return text.encode() + np.ascontiguousarray(boxes, "<f4").tobytes() + packed.tobytes() + coded.tobytes(), rows


def morton(points: np.ndarray, cut: float = 0.0) -> np.ndarray:
    """[N] int64: place of each of ``points`` [N, 3] on a space-filling curve (Morton 1966): the bits of x, y and z are interleaved. cut:
    percent of them at either end of an axis that may lie outside the curve's box and get the place of its rim."""
    if not len(points):
        return np.zeros(0, np.int64)
    low, high = np.percentile(points, [cut, 100 - cut], axis=0)
    cell = ((points - low) / np.maximum(high - low, 1e-12) * 1023).clip(0, 1023).astype(np.int64)
    code = np.zeros(len(points), np.int64)
    for bit in range(10):
        for axis in range(3):
            code |= (cell[:, axis] >> bit & 1) << (3 * bit + axis)
    return code


def _packed(values: np.ndarray, bits: tuple[int, ...]) -> np.ndarray:
    """[N] uint32: ``values`` [N, C] in [0, 1], column c quantised to ``bits[c]`` bits, the first column in the highest bits."""
    word = np.zeros(len(values), np.uint32)
    for column, count in zip(values.T, bits):
        most = (1 << count) - 1
        word = word << np.uint32(count) | np.rint(column * most).clip(0, most).astype(np.uint32)
    return word
