"""What was heard of videos before: every command about a capture asks for its clocks, and twenty minutes of sound take seconds."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path

import numpy as np

from ...pipeline.files import digest_bytes
from . import sound

KEPT_FROM = 60.0  # s of sound; less is heard again in a tenth of a second
_TOGETHER = 2  # videos; one of twenty minutes takes 0.3 GB
_VERSION = 1  # of what `sound.onsets` yields


def onsets_of(root: Path, names: Sequence[str], folder: Path | None) -> Iterator[tuple[np.ndarray, float] | None]:
    """`sound.onsets` of every name, in order. folder: where the long ones are kept, each under the file's path, size and time of change;
    one that cannot be written is done without."""
    with ThreadPoolExecutor(_TOGETHER) as pool:
        yield from pool.map(lambda name: _onsets(root, name, folder), names)


def _onsets(root: Path, name: str, folder: Path | None) -> tuple[np.ndarray, float] | None:
    place = None if folder is None else folder / f"{_key(root / name)}.npy"
    if place is not None and (known := _read(place)) is not None:
        return known
    found = sound.onsets(root, name)
    if place is not None and found is not None and len(found[0]) * sound.HOP >= KEPT_FROM * sound.RATE:
        with suppress(OSError):
            _write(place, found)
    return found


def _key(path: Path) -> str:
    there = path.resolve()
    found = there.stat()
    return digest_bytes(f"{_VERSION} {there} {found.st_size} {found.st_mtime_ns}".encode("utf-8", "surrogateescape"))[:32]


def _read(place: Path) -> tuple[np.ndarray, float] | None:
    try:
        values = np.load(place, allow_pickle=False)
    except (OSError, ValueError, EOFError):
        return None
    whole = values.dtype == np.float64 and values.ndim == 1 and len(values) > 1 and bool(np.isfinite(values).all())
    return (values[1:], float(values[0])) if whole else None


def _write(place: Path, found: tuple[np.ndarray, float]) -> None:
    place.parent.mkdir(parents=True, exist_ok=True)
    handle, part = tempfile.mkstemp(prefix=".", dir=place.parent)
    try:
        with os.fdopen(handle, "wb") as file:
            np.save(file, np.concatenate([[found[1]], found[0]]), allow_pickle=False)
        os.replace(part, place)
    except OSError:
        os.unlink(part)
        raise
