"""A zarr store for an artifact's folder in which a missing chunk is an error. Plain zarr would read it as zeros."""

from __future__ import annotations

from collections.abc import Container
from pathlib import Path
from typing import TYPE_CHECKING

from zarr.storage import LocalStore

from ..errors import DamagedError

if TYPE_CHECKING:
    from zarr.abc.store import ByteRequest
    from zarr.core.buffer import Buffer, BufferPrototype


class ListedStore(LocalStore):
    """Reads the artifact at ``path``. files: the names in its manifest; reading one of them that no longer exists raises DamagedError."""

    def __init__(self, path: Path, files: Container[str]) -> None:
        super().__init__(path, read_only=True)
        self.path, self.files = path, files

    async def get(self, key: str, prototype: BufferPrototype | None = None, byte_range: ByteRequest | None = None) -> Buffer | None:
        found = await super().get(key, prototype, byte_range)
        if found is None and key in self.files:
            raise DamagedError(self.path, key, "this file has gone while the artifact was read")
        return found
