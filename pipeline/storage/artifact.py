"""Reading an artifact. Nothing is trusted without a valid manifest."""

from __future__ import annotations

import errno
import json
import os
from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import ArtifactError, DamagedError
from ..files import canonical_json, digest_bytes, digest_files, sizes
from .chunks import layout_of, read_chunks
from .hold import hold, is_held_at

if TYPE_CHECKING:
    import numpy as np
    import zarr

MANIFEST = "manifest.json"
INFO = "info.json"
FORMAT = 1
AGAIN = "run the stage again with --force"


def content_digest(files: Mapping[str, list[Any]]) -> str:
    """Digest of the names, dtypes, shapes, chunks and bytes of the arrays, and of attrs. It leaves out ``info`` and the provenance.

    It is taken over the stored files (array metadata and encoded chunks), so the manifest alone is enough to compute it.
    """
    return digest_bytes(canonical_json({name: entry[1] for name, entry in files.items() if name != INFO}))


def seal(manifest: Mapping[str, Any]) -> str:
    """Digest of a manifest, excluding its own ``seal`` field."""
    return digest_bytes(canonical_json({name: value for name, value in manifest.items() if name != "seal"}))


def parse_manifest(path: Path, content: bytes) -> dict[str, Any]:
    """The manifest of the artifact at ``path``, given its bytes. Raises DamagedError."""
    try:
        manifest = json.loads(content)
    except ValueError as error:
        raise DamagedError(path, MANIFEST, f"the manifest cannot be read ({error})") from None
    if not isinstance(manifest, dict) or manifest.get("seal") != seal(manifest):
        raise DamagedError(path, MANIFEST, "the manifest is damaged")
    if manifest.get("format") != FORMAT:
        raise DamagedError(path, MANIFEST, f"it has format {manifest.get('format')}, and this version reads format {FORMAT}")
    return manifest


class Artifact:
    """One published zarr v3 group. Opening it checks the manifest and the size of every file, without decoding anything.

    As long as this object exists, garbage collection does not remove the artifact (see `hold`).
    Raises DamagedError if the manifest is missing or damaged, or if a file is missing, has the wrong size or is not listed; ArtifactError
    if the artifact cannot be read for another reason.
    """

    def __init__(self, path: Path) -> None:
        self.path = Path(path)
        self.manifest = self._read_manifest()
        try:
            found = sizes(self.path)
        except OSError as error:
            raise _unreadable(self.path, "", error) from error  # possibly another process has just moved it away
        found.pop(MANIFEST, None)
        for name, (size, _) in self.manifest["files"].items():
            if name not in found:
                raise DamagedError(self.path, name, "this file is in the manifest but not on disk")
            if found.pop(name) != size:
                raise DamagedError(self.path, name, f"the manifest says {size} bytes, but the file has another size")
        if found:
            raise DamagedError(self.path, min(found), "this file is not in the manifest")

    def _read_manifest(self) -> dict[str, Any]:
        try:
            content, self._held = hold(self, self.path / MANIFEST)
        except FileNotFoundError:
            raise DamagedError(self.path, MANIFEST, "there is no manifest, so the artifact was never finished") from None
        except OSError as error:
            raise _unreadable(self.path, MANIFEST, error) from error
        return parse_manifest(self.path, content)

    @property
    def digest(self) -> str:
        """Content digest, 64 hex digits. Equal arrays and attrs have equal digests."""
        return self.manifest["digest"]

    @property
    def provenance(self) -> dict[str, Any]:
        """Key parts, code and library versions, seeds, seconds, peak memory."""
        return self.manifest["provenance"]

    @cached_property
    def attrs(self) -> dict[str, Any]:
        """JSON values that are part of the content."""
        return json.loads(self._checked("zarr.json")).get("attributes", {})

    @cached_property
    def info(self) -> dict[str, Any]:
        """JSON values that are not part of the content: timings, curves, what was skipped."""
        return json.loads(self._checked(INFO))

    def _checked(self, name: str) -> bytes:
        """The content of one small file, compared with the manifest."""
        try:
            content = (self.path / name).read_bytes()
        except OSError as error:
            raise _unreadable(self.path, name, error) from error
        if digest_bytes(content) != self.manifest["files"][name][1]:
            raise DamagedError(self.path, name, "its content is not what was written", AGAIN)
        return content

    @cached_property
    def _group(self) -> zarr.Group:
        import zarr

        from .listed import ListedStore

        self._checked("zarr.json")
        return zarr.open_group(ListedStore(self.path, self.manifest["files"]), mode="r", zarr_format=3)

    def names(self) -> list[str]:
        """Names of the arrays, sorted."""
        return sorted(name[: -len("/zarr.json")] for name in self.manifest["files"] if name.endswith("/zarr.json"))

    def __contains__(self, name: object) -> bool:
        return f"{name}/zarr.json" in self.manifest["files"]

    def _known(self, name: str) -> None:
        if name not in self:
            raise ArtifactError(f"{self.path}: there is no array {name!r}; it has {', '.join(self.names()) or 'none'}")

    def array(self, name: str) -> zarr.Array:
        """The array, not yet read. Slices are read and checked (crc32c) chunk by chunk. Raises ArtifactError for an unknown name.

        Reading a slice raises DamagedError if the file of a chunk is missing.
        """
        self._known(name)
        if name not in self._described:
            self._checked(f"{name}/zarr.json")  # otherwise a modified shape or dtype would go unnoticed
            self._described.add(name)
        array: Any = self._group[name]
        return array

    @cached_property
    def _described(self) -> set[str]:
        return set()

    def read(self, name: str, part: Any = ...) -> np.ndarray:
        """A whole array, with every file compared with the manifest, or only the ``part`` that an index or slice selects. Raises
        ArtifactError if a chunk is damaged, and without advice to make it again if it only cannot be read now."""
        self._known(name)
        try:
            layout = layout_of(json.loads(self._checked(f"{name}/zarr.json"))) if part is ... else None
            data: Any = read_chunks(self.path, name, layout, self.manifest["files"]) if layout is not None else self.array(name)[part]
        except (ValueError, RuntimeError, OSError) as error:
            if isinstance(error, OSError) and error.errno is not None and not _is_damage(error):
                raise _unreadable(self.path, name, error) from error
            raise ArtifactError(f"{self.path}: array {name!r} is damaged ({error}); {AGAIN}") from error
        if not is_held_at(self._held, self.path / MANIFEST):
            raise ArtifactError(f"{self.path}: another process has replaced this artifact while {name!r} was read; run again")
        return data

    def verify(self, arrays: bool = True) -> None:
        """Reads every byte and compares it with the manifest. With ``arrays=False``, only the descriptions, attrs and info, which is quick.

        Raises a DamagedError that names the first damaged file.
        """
        names = [name for name in self.manifest["files"] if arrays or name.endswith(".json")]
        if not arrays:
            for name in names:
                self._checked(name)
            return
        try:
            digests = digest_files(self.path, names)
        except OSError as error:
            raise _unreadable(self.path, "", error) from error
        for name in names:
            if digests[name] != self.manifest["files"][name][1]:
                raise DamagedError(self.path, name, "its content is not what was written", AGAIN)
        if content_digest(self.manifest["files"]) != self.digest:
            raise DamagedError(self.path, MANIFEST, "the content digest does not match the files", AGAIN)


def _unreadable(path: Path, name: str, error: OSError) -> ArtifactError:
    """DamagedError if a file is gone or the disk cannot read it. Problems that may be temporary (permissions, too many open files) do not
    count as damage and give an ArtifactError."""
    if _is_damage(error):
        file = os.path.relpath(error.filename, path) if error.filename else name
        return DamagedError(path, file, f"cannot be read ({error.strerror})", AGAIN)
    return ArtifactError(f"{error.filename or path / name}: cannot be read ({error.strerror})")


def _is_damage(error: OSError) -> bool:
    return error.errno in (errno.ENOENT, errno.EIO, errno.EISDIR, errno.ENOTDIR)
