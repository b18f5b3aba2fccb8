"""Loads arrays from untrusted `.npy` and `.npz` files. The claims of the header are checked against the file first."""

from __future__ import annotations

import math
import zipfile
from pathlib import Path
from typing import IO

import numpy as np

from ...pipeline import CaptureError
from . import checks

MOST_POINTS = 10_000_000  # most rows of a point cloud


def load_array(root: Path, name: str, columns: tuple[int, ...], member: str | None = None, most: int = MOST_POINTS) -> np.ndarray:
    """The array in `root/name`, or the array `member` of an .npz file, as float64 [N, one of `columns`]; N may be 0.

    Raises CaptureError if it is not such an array, is truncated, holds pickled objects, or has more than `most` rows.
    """
    path = checks.resolve_inside(root, name, name)
    where = name if member is None else f"{name}: {member}"
    try:
        if member is None:
            with path.open("rb") as file:
                table = _read(file, path.stat().st_size, where, columns, most)
        else:
            with zipfile.ZipFile(path) as archive, archive.open(f"{member}.npy") as part:
                table = _read(part, archive.getinfo(f"{member}.npy").file_size, where, columns, most)
    except CaptureError:
        raise
    except Exception as error:  # broken zip files and numpy headers raise many kinds of errors
        raise CaptureError(f"{where}: not a readable numpy array ({error or type(error).__name__}); copy it again or remove it") from error
    return table.astype(np.float64, copy=False)


def _read(file: IO[bytes], size: int, where: str, columns: tuple[int, ...], most: int) -> np.ndarray:
    """The array in `file` of `size` bytes."""
    begin = file.tell()
    version = np.lib.format.read_magic(file)
    if version not in ((1, 0), (2, 0)):
        raise ValueError(f"version {version} of the format")
    header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, _, dtype = header(file)
    if dtype.hasobject:
        raise ValueError("it holds pickled objects")
    if len(shape) != 2 or shape[1] not in columns or dtype.kind not in "fiu":
        expected = " or ".join(map(str, columns))
        raise CaptureError(f"{where}: expected numbers [N,{expected}], found {dtype} {list(shape)}; correct the file or remove it")
    promised = math.prod(shape) * dtype.itemsize
    if not 0 <= shape[0] <= most:
        raise CaptureError(f"{where}: {shape[0]} rows are too many for a capture; thin them out or remove the file")
    if promised > size:
        raise CaptureError(
            f"{where}: {list(shape)} are promised, which its {size} bytes cannot hold; it is cut short: copy it again or remove it"
        )
    file.seek(begin)
    return np.asarray(np.lib.format.read_array(file, allow_pickle=False))
