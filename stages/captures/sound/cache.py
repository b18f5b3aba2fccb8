"""Caches the sound envelopes of long videos. Every command on a capture needs its clocks, and analysing twenty minutes of sound takes
seconds."""

from __future__ import annotations

import io
import os
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path

import numpy as np

from ....pipeline import thread_count
from ....pipeline.files import digest_bytes, digest_file, write_atomically
from . import onsets

KEPT_FROM = 60.0  # s of sound from which the result is cached; shorter sound is analysed again in a tenth of a second
_TOGETHER = 2  # most videos at a time; one of twenty minutes takes 0.3 GB
_VERSION = 2  # of the result of `onsets.onsets`
_DIGEST = 64  # characters of the BLAKE3 digest in front of the values


def onsets_of(root: Path, names: Sequence[str], folder: Path | None) -> Iterator[tuple[np.ndarray, float] | None]:
    """`onsets.onsets` of every name, in order. folder: cache for long ones, each stored under the digest of the video's content. Failing to
    write the cache is not an error, and a damaged entry is ignored and computed again."""
    with ThreadPoolExecutor(thread_count(_TOGETHER)) as pool:
        yield from pool.map(lambda name: _onsets(root, name, folder), names)


def _onsets(root: Path, name: str, folder: Path | None) -> tuple[np.ndarray, float] | None:
    place = None if folder is None else folder / f"{_key(root / name)}.onsets"
    if place is not None and (known := _read(place)) is not None:
        return known
    found = onsets.onsets(root, name)
    if place is not None and found is not None and len(found[0]) * onsets.HOP >= KEPT_FROM * onsets.RATE:
        with suppress(OSError):
            _write(place, found)
    return found


def _key(path: Path) -> str:
    """Cache key from the whole content: reading a video is fast compared with analysing its sound, and modification times may be wrong."""
    return digest_bytes(f"{_VERSION} {digest_file(path)}".encode())[:32]


def _read(place: Path) -> tuple[np.ndarray, float] | None:
    """A cache entry; None if it is missing or damaged. Its modification time is set to the time of last use, for `gc`."""
    try:
        content = place.read_bytes()
        if content[:_DIGEST] != _digest(place, content[_DIGEST:]):
            return None
        values = np.load(io.BytesIO(content[_DIGEST:]), allow_pickle=False)
    except (OSError, ValueError, EOFError):
        return None
    with suppress(OSError):
        os.utime(place)
    return values[1:], float(values[0])


def _write(place: Path, found: tuple[np.ndarray, float]) -> None:
    values = io.BytesIO()
    np.save(values, np.concatenate([[found[1]], found[0]]), allow_pickle=False)
    write_atomically(place, _digest(place, values.getvalue()) + values.getvalue())


def _digest(place: Path, values: bytes) -> bytes:
    """Digest of the key and the values, so that a file renamed to another key is rejected too."""
    return digest_bytes(place.stem.encode() + values).encode()
