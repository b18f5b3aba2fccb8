"""Gaussians of one moment as an SPZ file (Niantic, version 3), at most a fifth of the size of a PLY file."""

from __future__ import annotations

import gzip
import struct

import numpy as np

from ...rasterizer import Gaussians
from ..primitives import SH_C0
from .ply import seen
from .smallest_three import LARGEST, smallest_three

MAGIC, VERSION = 0x5053474E, 3
MOST = 2**23 - 1  # greatest coordinate: signed 24 bits
FRACTION = 20  # most fraction bits of a coordinate
ANTIALIASED = 1  # a flag of the header
LEAST_LOG, LOG_STEPS = -10, 16  # of ln of a standard deviation: the least, and steps in each unit; there are 256
BASE = 0.15  # bytes of a base colour are (0.5 + BASE times its coefficient of SH) 255
COARSE = 0.25  # of the median Gaussian's standard deviation: a step of positions that can be seen


def spz_bytes(gaussians: Gaussians, antialiased: bool = False) -> tuple[bytes, int]:
    """The file with the visible ones among ``gaussians`` (with sh), and their number. SPZ's axes are right, up, back; nothing is turned
    here. antialiased: set the flag that tells that the Gaussians are meant for renderers that compensate opacity.

    gzip of a header and of all positions (24 bits, with as many fraction bits as the farthest one allows), opacities, colours, scales (ln
    in steps of 1/16), rotations (three components of 10 bits) and SH (8 bits for -1 to 1; by coefficient, then channel). Raises ValueError
    if a position does not fit.
    """
    shown = seen(gaussians)
    assert shown.sh is not None
    means, quats, sh = (a.detach().cpu().double().numpy() for a in (shown.means, shown.quats, shown.sh))
    scales, opacities = (a.detach().cpu().double().numpy() for a in (shown.scales, shown.opacities))
    rows, degree = len(means), round(sh.shape[1] ** 0.5) - 1
    fraction = fraction_bits(float(np.abs(means).max(initial=0.0)))
    fixed = np.rint(means * 2.0**fraction).astype("<i4")
    parts = [
        struct.pack("<IIIBBBB", MAGIC, VERSION, rows, degree, fraction, ANTIALIASED * antialiased, 0),
        np.ascontiguousarray(fixed.reshape(-1, 1).view("u1")[:, :3]).tobytes(),
        _bytes(opacities * 255),
        _bytes(_base_steps(sh)),
        _bytes(_log_steps(scales)),
        _rotations(quats).tobytes(),
        _bytes(_rest_steps(sh)),
    ]
    return gzip.compress(b"".join(parts), mtime=0), rows


def cut_by_spz(gaussians: Gaussians) -> list[str]:
    """What of the visible ones among ``gaussians`` (with sh) the format cannot hold, or not as closely as their size asks for, a line each.
    It has no unit of length, so a scene in millimetres, or with one Gaussian very far away, meets the limits of length."""
    shown = seen(gaussians)
    if not len(shown.means):
        return []
    widest = shown.scales.detach().cpu().double().numpy().max(1)
    low, high = (float(np.exp(LEAST_LOG + k / LOG_STEPS)) for k in (0, 255))
    middle, farthest = float(np.median(widest)), float(shown.means.abs().max())
    found, instead = [], "export ply or sog instead"
    if beyond := int(_outside(_log_steps(widest)).sum()):
        counts = f"{beyond} of {len(widest)} Gaussians are not that size and are cut"
        found.append(f"SPZ holds standard deviations of {low:.2g} to {high:.3g} world units; {counts}; {instead}")
    if farthest <= MOST and (step := 2.0 ** -fraction_bits(farthest)) > COARSE * middle:
        far = f"a Gaussian lies {farthest:.3g} world units away, so SPZ rounds all positions to {step:.2g}"
        found.append(f"{far}, while the median standard deviation is {middle:.2g}; {instead}")
    assert shown.sh is not None
    sh = shown.sh.detach().cpu().double().numpy()
    for what, limits, parts in (
        ("base colours", f"of {0.5 - SH_C0 / (2 * BASE):.2g} to {0.5 + SH_C0 / (2 * BASE):.3g}", _base_steps(sh)),
        ("SH above degree 0", "of -1 to 0.99", _rest_steps(sh)),
    ):
        if beyond := int(_outside(parts).reshape(len(sh), -1).any(1).sum()):
            found.append(f"SPZ holds {what} {limits}; {beyond} of {len(sh)} Gaussians have some beyond, which are cut; {instead}")
    return found


def _base_steps(sh: np.ndarray) -> np.ndarray:
    return np.asarray((0.5 + BASE * sh[:, 0]) * 255)


def _rest_steps(sh: np.ndarray) -> np.ndarray:
    return np.asarray(sh[:, 1:] * 128 + 128)


def _outside(steps: np.ndarray) -> np.ndarray:
    """Which of the numbers that `_bytes` writes it would cut."""
    rounded = np.rint(steps)
    return np.asarray((rounded < 0) | (rounded > 255))


def _log_steps(scales: np.ndarray) -> np.ndarray:
    return np.asarray((np.log(scales) - LEAST_LOG) * LOG_STEPS)


def fraction_bits(farthest: float) -> int:
    """How many of a coordinate's 24 bits can be fraction bits if none is farther than ``farthest`` from 0. Raises ValueError."""
    if farthest > MOST:
        raise ValueError(f"a Gaussian lies {farthest:.3g} world units away, and SPZ holds {MOST} at most")
    return next(bits for bits in range(FRACTION, -1, -1) if farthest * 2.0**bits <= MOST)


def _bytes(values: np.ndarray) -> bytes:
    return np.rint(values).clip(0, 255).astype("u1").tobytes()


def _rotations(quats: np.ndarray) -> np.ndarray:
    """[N] uint32 for ``quats`` [N, 4] w x y z: the index of x y z w that is left out, then a sign and nine bits for each of the others."""
    left_out, others = smallest_three(quats[:, [1, 2, 3, 0]])
    word = left_out.astype("<u4")
    for part in others.T:
        size = np.rint(np.abs(part) / LARGEST * 511).clip(0, 511).astype("<u4")
        word = word << np.uint32(10) | (part < 0).astype("<u4") << np.uint32(9) | size
    return word
