"""What was heard of videos before: every command about a capture asks for its clocks, and twenty minutes of sound take seconds."""

from __future__ import annotations

import io
import os
import tempfile
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path

import numpy as np

from ...pipeline import thread_count
from ...pipeline.files import digest_bytes, digest_file
from . import sound

KEPT_FROM = 60.0  # s of sound; less is heard again in a tenth of a second
_TOGETHER = 2  # videos at most; one of twenty minutes takes 0.3 GB
_VERSION = 1  # of what `sound.onsets` yields
_DIGEST = 64  # characters of BLAKE3 before the values


def onsets_of(root: Path, names: Sequence[str], folder: Path | None) -> Iterator[tuple[np.ndarray, float] | None]:
    """`sound.onsets` of every name, in order. folder: where the long ones are kept, each under the digest of the video's content; one that
    cannot be written is done without, and one that is not as it was written is heard again."""
    with ThreadPoolExecutor(thread_count(_TOGETHER)) as pool:
        yield from pool.map(lambda name: _onsets(root, name, folder), names)


def _onsets(root: Path, name: str, folder: Path | None) -> tuple[np.ndarray, float] | None:
    place = None if folder is None else folder / f"{_key(root / name)}.onsets"
    if place is not None and (known := _read(place)) is not None:
        return known
    found = sound.onsets(root, name)
    if place is not None and found is not None and len(found[0]) * sound.HOP >= KEPT_FROM * sound.RATE:
        with suppress(OSError):
            _write(place, found)
    return found


def _key(path: Path) -> str:
    """Reading all of a video is quick beside hearing it, and a time of change may lie."""
    return digest_bytes(f"{_VERSION} {digest_file(path)}".encode())[:32]


def _read(place: Path) -> tuple[np.ndarray, float] | None:
    """None where there is nothing, or not what was written there. Its time of change says when it was last used, for `gc`."""
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
    place.parent.mkdir(parents=True, exist_ok=True)
    handle, part = tempfile.mkstemp(prefix=".", dir=place.parent)
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(_digest(place, values.getvalue()) + values.getvalue())
        os.replace(part, place)
    except OSError:
        os.unlink(part)
        raise


def _digest(place: Path, values: bytes) -> bytes:
    """Of the key and the values, so that a file under another's name does not count either."""
    return digest_bytes(place.stem.encode() + values).encode()
