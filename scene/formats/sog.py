"""Gaussians of one moment as a SOG file (PlayCanvas, version 2): lossless WebP images of bytes, a pixel a Gaussian, in a zip archive."""

from __future__ import annotations

import io
import json
import zipfile

import numpy as np
import torch
from PIL import Image

from ...rasterizer import Gaussians
from .compressed_ply import morton
from .ply import seen
from .smallest_three import LARGEST, smallest_three
from .tables import nearest_numbers, table_of_numbers, table_of_vectors

META = "meta.json"
NUMBERS = 256  # in a table of scales, colours or coefficients: an index is a byte
VECTORS = 2**16  # most in the table of SH above degree 0: an index is two bytes
ACROSS = 64  # vectors in a row of their image
FOUR = 252  # alpha of a rotation whose w is left out; x, y, z follow
EFFORT = 30  # of 100, of the WebP encoder: more takes up to 30 s for 140,000 Gaussians and gains a thousandth


def sog_bytes(gaussians: Gaussians, antialiased: bool = False) -> tuple[bytes, int]:
    """The file with the visible ones among ``gaussians`` (with sh), and their number. antialiased: tell in meta.json that the Gaussians are
    meant for renderers that compensate opacity; splat-transform (3.2 and later) reads and writes "model" for it.

    Positions have 16 bits between the least and the greatest of sign(x) ln(1 + |x|); scales (ln) and colours are indices into tables of 256
    values, opacities 8 bits, rotations three components of 8 bits. SH above degree 0 is an index into a table of 65536 vectors at most, of
    numbers from a table of 256. An image has at least a pixel, so if none is visible, the file holds one that is transparent."""
    shown = seen(gaussians)
    assert shown.sh is not None
    number = len(shown.means)
    if not number:
        shown = _transparent(shown.sh.shape[1])
    rows = len(shown.means)
    assert shown.sh is not None
    means, quats, sh = (a.detach().cpu().float().numpy() for a in (shown.means, shown.quats, shown.sh))
    scales, opacities = (a.detach().cpu().float().numpy() for a in (shown.scales, shown.opacities))
    curved = np.sign(means) * np.log1p(np.abs(means.astype(np.float64)))
    low, high = curved.min(0), curved.max(0)
    fixed = np.rint((curved - low) / np.maximum(high - low, 1e-30) * 65535).astype(np.int64)
    order = np.argsort(morton(curved), kind="stable")  # neighbours look alike, which makes the images smaller
    left_out, others = smallest_three(quats)
    codes = [_bytes((others / LARGEST + 1) * 127.5), FOUR + left_out[:, None]]
    logs, colors = np.log(scales), sh[:, 0]
    of_scales, of_colors = table_of_numbers(logs, NUMBERS), table_of_numbers(colors, NUMBERS)
    meta: dict[str, object] = {
        "version": 2,
        "asset": {"generator": "e4dgs"},
        "count": rows,
        "antialias": antialiased,
        **({"model": "antialiased"} if antialiased else {}),
        "means": {"mins": low.tolist(), "maxs": high.tolist(), "files": ["means_l.webp", "means_u.webp"]},
        "scales": {"codebook": of_scales.tolist(), "files": ["scales.webp"]},
        "quats": {"files": ["quats.webp"]},
        "sh0": {"codebook": of_colors.tolist(), "files": ["sh0.webp"]},
    }
    images = {
        "means_l.webp": fixed & 255,
        "means_u.webp": fixed >> 8,
        "scales.webp": nearest_numbers(logs, of_scales),
        "quats.webp": np.concatenate(codes, 1),
        "sh0.webp": np.concatenate([nearest_numbers(colors, of_colors), _bytes(opacities[:, None] * 255)], 1),
    }
    width = int(np.ceil(np.sqrt(rows)))
    files = {name: _webp(image[order], width) for name, image in images.items()}
    if sh.shape[1] > 1:
        files |= _rest(sh[order, 1:], width, meta)
    return _zip({META: json.dumps(meta).encode(), **files}), number


def _transparent(coefficients: int) -> Gaussians:
    """One Gaussian that shows nothing."""
    none = torch.zeros(1, coefficients, 3)
    return Gaussians(torch.zeros(1, 3), torch.tensor([[1.0, 0, 0, 0]]), torch.ones(1, 3), torch.zeros(1), sh=none)


def _rest(sh: np.ndarray, width: int, meta: dict[str, object]) -> dict[str, bytes]:
    """The images for ``sh`` [N, K, 3] above degree 0, by name: one row of K pixels a vector, and the index of each Gaussian's. Adds
    to ``meta`` what they are."""
    rows, coefficients, _ = sh.shape
    vectors, index = table_of_vectors(sh.reshape(rows, -1), VECTORS)
    table = table_of_numbers(vectors, NUMBERS)
    names = ["shN_centroids.webp", "shN_labels.webp"]
    bands = round((coefficients + 1) ** 0.5) - 1
    meta["shN"] = {"count": len(vectors), "bands": bands, "codebook": table.tolist(), "files": names}
    labels = np.stack([index & 255, index >> 8, np.zeros_like(index)], 1)
    pixels = nearest_numbers(vectors, table).reshape(-1, 3)
    return dict(zip(names, (_webp(pixels, ACROSS * coefficients), _webp(labels, width))))


def _bytes(values: np.ndarray) -> np.ndarray:
    return np.asarray(np.rint(values).clip(0, 255))


def _webp(pixels: np.ndarray, width: int) -> bytes:
    """A lossless image of ``pixels`` [N, 3 or 4], row by row; what is left of the last row is 0."""
    height = -(-len(pixels) // width)
    image = np.zeros((height * width, pixels.shape[1]), np.uint8)
    image[: len(pixels)] = pixels
    made = io.BytesIO()
    # exact: colours are kept where alpha is 0
    Image.fromarray(image.reshape(height, width, -1)).save(made, "WEBP", lossless=True, quality=EFFORT, method=4, exact=True)
    return made.getvalue()


def _zip(files: dict[str, bytes]) -> bytes:
    """An archive of ``files`` without times, so that the same files are the same bytes."""
    made = io.BytesIO()
    with zipfile.ZipFile(made, "w", zipfile.ZIP_STORED) as archive:
        for name, data in files.items():
            archive.writestr(zipfile.ZipInfo(name), data)
    return made.getvalue()
