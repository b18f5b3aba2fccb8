"""Reads and writes whole arrays directly from and to their chunk files, byte for byte as zarr stores them.

Reading compares each file with the manifest. It takes half of zarr's time for an array that does not compress, and slightly less than
zarr's time for one that does: zarr passes every chunk through an event loop and copies it more than once.
"""

from __future__ import annotations

import itertools
import math
import threading
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from blake3 import blake3

from ..errors import DamagedError
from ..machine.threads import waiting_threads

if TYPE_CHECKING:
    import numpy as np

_TYPES = {"bool": "?", "float16": "<f2", "float32": "<f4", "float64": "<f8"}
_TYPES |= {f"{sign}int{8 * size}": f"<{kind}{size}" for sign, kind in (("", "i"), ("u", "u")) for size in (1, 2, 4, 8)}
LEVEL = 1  # compression level of zstd
_FEW = 1 << 20  # bytes; for arrays up to this size, threads are not worth it
_CRC = 4  # bytes of the checksum at the end of a chunk, for readers that have no manifest


@dataclass(frozen=True)
class Layout:
    """How an array is stored in files. chunk: the shape of one chunk; chunks at the upper ends of the array are stored at full size too."""

    shape: tuple[int, ...]
    chunk: tuple[int, ...]
    dtype: str
    zstd: bool


def layout_of(description: Mapping[str, Any]) -> Layout | None:
    """The layout that a zarr.json describes, or None if this module does not support it."""
    grid, keys = description.get("chunk_grid", {}), description.get("chunk_key_encoding", {})
    codecs = description.get("codecs", [])
    names = [codec["name"] for codec in codecs]
    known = (
        description.get("zarr_format") == 3
        and description.get("data_type") in _TYPES
        and grid.get("name") == "regular"
        and keys == {"name": "default", "configuration": {"separator": "/"}}
        and names in (["bytes", "zstd", "crc32c"], ["bytes", "crc32c"])
        and codecs[0].get("configuration", {}).get("endian", "little") == "little"
        and not description.get("storage_transformers")
    )
    if not known:
        return None
    return Layout(
        tuple(description["shape"]), tuple(grid["configuration"]["chunk_shape"]), _TYPES[description["data_type"]], "zstd" in names
    )


def write_chunks(path: Path, name: str, layout: Layout, array: np.ndarray) -> None:
    """Writes all chunks of the array ``name`` of the artifact at ``path``. Its zarr.json must exist already. Raises OSError."""
    import numpy as np
    from google_crc32c import value as crc32c
    from numcodecs.zstd import Zstd

    codec = Zstd(level=LEVEL)  # what `ArtifactWriter.create` asks for

    def one(place: tuple[int, ...]) -> None:
        block = array[_within(place, layout)]
        if block.shape != layout.chunk:  # at an upper end; the chunk is padded with zeros to its full size
            whole = np.zeros(layout.chunk, layout.dtype)
            whole[tuple(slice(0, size) for size in block.shape)] = block
            block = whole
        block = np.ascontiguousarray(block, layout.dtype)
        content = codec.encode(block)
        file = path / _file(name, place)
        file.parent.mkdir(parents=True, exist_ok=True)
        try:
            with open(file, "wb") as target:
                target.write(content)
                target.write(crc32c(content).to_bytes(_CRC, "little"))
        except OSError as error:
            error.filename = error.filename or str(file)  # the error of a failed write does not name the file
            raise

    _for_all(one, layout, array.nbytes)


def read_chunks(path: Path, name: str, layout: Layout, files: Mapping[str, list[Any]]) -> np.ndarray:
    """The array ``name`` of the artifact at ``path``. ``files`` is from its manifest. Raises DamagedError, naming the file, or OSError."""
    import numpy as np

    out = np.empty(layout.shape, layout.dtype)
    decode = _decoder(layout)
    room = threading.local()  # each thread reuses one buffer for its chunks, because fresh memory costs more than the reading

    def one(place: tuple[int, ...]) -> None:
        file, target = _file(name, place), out[_within(place, layout)]
        content = _read(path, file, name, files, room)
        try:
            if target.shape == layout.chunk and target.flags.c_contiguous:
                decode(content, target)
            else:
                whole = np.empty(layout.chunk, layout.dtype)
                decode(content, whole)
                target[...] = whole[tuple(slice(0, size) for size in target.shape)]
        except (ValueError, RuntimeError) as error:
            raise DamagedError(path, file, f"array {name!r} is damaged ({error})") from error

    _for_all(one, layout, out.nbytes)
    return out


def _file(name: str, place: tuple[int, ...]) -> str:
    return "/".join([name, "c", *map(str, place)])


def _within(place: tuple[int, ...], layout: Layout) -> tuple[Any, ...]:
    """The index that selects a chunk's part of an array. The trailing ``...`` makes it return a view even of a 0-dimensional array, where
    an index of () would return a separate scalar."""
    return *(slice(k * chunk, min((k + 1) * chunk, size)) for k, chunk, size in zip(place, layout.chunk, layout.shape)), ...


def _for_all(one: Callable[[tuple[int, ...]], None], layout: Layout, nbytes: int) -> None:
    places = itertools.product(*(range(math.ceil(size / chunk)) for size, chunk in zip(layout.shape, layout.chunk)))
    if nbytes <= _FEW:
        for place in places:
            one(place)
    else:
        with ThreadPoolExecutor(waiting_threads()) as pool:
            list(pool.map(one, places))


def _read(path: Path, file: str, name: str, files: Mapping[str, list[Any]], room: threading.local) -> memoryview:
    """The content of a chunk file, checked against the manifest. It stays in ``room`` until the thread reads the next chunk."""
    import numpy as np

    damaged = f"array {name!r} is damaged: its content is not what was written"
    if file not in files:
        raise DamagedError(path, file, f"array {name!r} is damaged: this file is not in the manifest")
    size, digest = files[file]
    if len(getattr(room, "buffer", ())) < size:
        room.buffer = np.empty(size, np.uint8).data
    content = room.buffer[:size]
    with open(path / file, "rb", buffering=0) as source:
        found = 0
        while found < size and (more := source.readinto(content[found:])):
            found += more
        if found < size or source.read(1) or blake3(content).hexdigest() != digest:
            raise DamagedError(path, file, damaged, "run the stage again with --force")
    return content


def _decoder(layout: Layout) -> Callable[[memoryview, Any], None]:
    if layout.zstd:
        from numcodecs.zstd import Zstd

        codec = Zstd()

        def decode(content: memoryview, target: Any) -> None:
            codec.decode(content[:-_CRC], target)

        return decode

    def copy(content: memoryview, target: Any) -> None:
        import numpy as np

        target[...] = np.frombuffer(content[:-_CRC], target.dtype).reshape(target.shape)

    return copy
