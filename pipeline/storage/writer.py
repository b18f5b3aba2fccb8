"""Writing an artifact: complete arrays with checksums, then the manifest."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import StageError
from ..files import digest_files, sizes, sync_tree, write_json
from .artifact import FORMAT, INFO, MANIFEST, content_digest, seal
from .chunks import LEVEL, layout_of, write_chunks

if TYPE_CHECKING:
    import numpy as np
    import zarr

_CHUNK_BYTES = 16 << 20
_KINDS = "biuf"  # bool, integers and floats; nothing that would need pickle


class ArtifactWriter:
    """Fills a folder that nobody reads until the store publishes it. ``attrs`` is part of the content; ``info`` is not (use it for
    timings)."""

    def __init__(self, path: Path) -> None:
        self.path = Path(path)
        self.attrs: dict[str, Any] = {}
        self.info: dict[str, Any] = {}

    @cached_property
    def _group(self) -> zarr.Group:
        import zarr

        return zarr.open_group(self.path, mode="a", zarr_format=3)

    def write(self, name: str, array: np.ndarray, unit: str = "", doc: str = "") -> None:
        """Writes a whole array (bool, integer or float, any shape). A large array is split into chunks along the first axis."""
        import numpy as np

        array = np.asarray(array)
        rows = array.shape[0] if array.ndim else 1
        per_row = max(1, array.nbytes // max(1, rows))
        first = min(max(1, rows), max(1, _CHUNK_BYTES // per_row))
        chunks = (first, *array.shape[1:]) if array.ndim else ()
        created = self.create(name, array.shape, array.dtype, chunks, unit, doc)
        layout = layout_of(created.metadata.to_dict())
        if layout is None:  # big-endian numbers, or a version of zarr that describes arrays differently
            created[...] = array
        else:
            write_chunks(self.path, name, layout, array)

    def create(self, name: str, shape: Sequence[int], dtype: Any, chunks: Sequence[int], unit: str = "", doc: str = "") -> zarr.Array:
        """A new array to be filled in parts. Every chunk must be written by the end of the stage. Raises StageError for other dtypes."""
        import numpy as np
        from zarr.codecs import Crc32cCodec, ZstdCodec

        dtype = np.dtype(dtype)
        if dtype.kind not in _KINDS:
            raise StageError(f"array {name!r}: dtype {dtype} cannot be stored; use bool, integers or floats")
        return self._group.create_array(
            name,
            shape=tuple(int(size) for size in shape),
            dtype=dtype,
            chunks=tuple(max(1, int(size)) for size in chunks),
            compressors=[ZstdCodec(level=LEVEL), Crc32cCodec()],
            fill_value=0,
            attributes={"unit": unit, "doc": doc},
            config={"write_empty_chunks": True},
        )

    def finish(self, provenance: Mapping[str, Any]) -> str:
        """Writes attrs, info and the manifest, makes sure that everything is on disk, and returns the content digest.

        Raises StageError if a chunk was never written, because a reader would see zeros there.
        """
        try:
            json.dumps([self.attrs, self.info], allow_nan=False)
        except (TypeError, ValueError) as error:
            raise StageError(f"attrs or info are not JSON: {error}") from error
        self._group.update_attributes(json.loads(json.dumps(self.attrs, sort_keys=True)))
        for name, array in sorted(self._group.arrays()):
            expected = math.prod(math.ceil(size / chunk) for size, chunk in zip(array.shape, array.chunks))
            written = sum(1 for file in sizes(self.path / name) if file != "zarr.json")
            if written != expected:
                raise StageError(f"array {name!r}: {expected - written} of its {expected} chunks were never written")
        (self.path / INFO).write_bytes((json.dumps(self.info, indent=2, ensure_ascii=False) + "\n").encode())  # synced below with the rest
        found = sizes(self.path)
        digests = digest_files(self.path, found)
        files = {name: [found[name], digest] for name, digest in digests.items()}
        sync_tree(self.path, files)
        manifest: dict[str, Any] = {
            "format": FORMAT,
            "digest": content_digest(files),
            "files": files,
            "provenance": json.loads(json.dumps(provenance)),
        }
        manifest["seal"] = seal(manifest)
        write_json(self.path / MANIFEST, manifest)
        return manifest["digest"]
