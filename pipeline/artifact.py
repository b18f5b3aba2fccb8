"""Reading an artifact: nothing is believed without a valid manifest."""

from __future__ import annotations

import json
from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .errors import ArtifactError
from .files import canonical_json, digest_bytes, digest_files, sizes

if TYPE_CHECKING:
    import numpy as np
    import zarr

MANIFEST = "manifest.json"
INFO = "info.json"
FORMAT = 1


def content_digest(files: Mapping[str, list[Any]]) -> str:
    """Digest of names, dtypes, shapes, chunks and bytes of the arrays and of attrs; ``info`` and provenance are left out.

    It covers the stored files (array metadata and encoded chunks), so it follows from the manifest alone.
    """
    return digest_bytes(canonical_json({name: entry[1] for name, entry in files.items() if name != INFO}))


def seal(manifest: Mapping[str, Any]) -> str:
    """Digest of a manifest without its own ``seal`` field."""
    return digest_bytes(canonical_json({name: value for name, value in manifest.items() if name != "seal"}))


class Artifact:
    """One published zarr v3 group. Opening it checks the manifest and the size of every file, which costs no decoding.

    Raises ArtifactError when the manifest is missing or damaged, or a file is missing, cut short or not listed.
    """

    def __init__(self, path: Path) -> None:
        self.path = Path(path)
        self.manifest = self._read_manifest()
        try:
            found = sizes(self.path)
        except OSError as error:
            raise ArtifactError(f"{self.path}: cannot be listed ({error.strerror})") from error
        found.pop(MANIFEST)
        for name, (size, _) in self.manifest["files"].items():
            if name not in found:
                raise ArtifactError(f"{self.path / name}: this file is in the manifest and not on disk; run the stage again")
            if found.pop(name) != size:
                raise ArtifactError(
                    f"{self.path / name}: the manifest says {size} bytes and the file has another size; run the stage again"
                )
        if found:
            raise ArtifactError(f"{self.path / min(found)}: this file is not in the manifest; run the stage again")

    def _read_manifest(self) -> dict[str, Any]:
        path = self.path / MANIFEST
        try:
            manifest = json.loads(path.read_bytes())
        except FileNotFoundError:
            raise ArtifactError(f"{path}: there is no manifest, so the artifact was never finished; run the stage again") from None
        except (OSError, ValueError) as error:
            raise ArtifactError(f"{path}: the manifest cannot be read ({error}); run the stage again") from None
        if not isinstance(manifest, dict) or manifest.get("format") != FORMAT or manifest.get("seal") != seal(manifest):
            raise ArtifactError(f"{path}: the manifest is damaged or of another format; run the stage again")
        return manifest

    @property
    def digest(self) -> str:
        """Content digest, 64 hex digits; equal for equal arrays and attrs."""
        return self.manifest["digest"]

    @property
    def provenance(self) -> dict[str, Any]:
        """Key parts, code and library versions, seeds, seconds, peak memory."""
        return self.manifest["provenance"]

    @cached_property
    def attrs(self) -> dict[str, Any]:
        """JSON values that belong to the content."""
        return json.loads((self.path / "zarr.json").read_bytes()).get("attributes", {})

    @cached_property
    def info(self) -> dict[str, Any]:
        """JSON values that do not belong to the content: timings, curves, what was skipped."""
        return json.loads((self.path / INFO).read_bytes())

    @cached_property
    def _group(self) -> zarr.Group:
        import zarr

        return zarr.open_group(self.path, mode="r", zarr_format=3)

    def names(self) -> list[str]:
        """Names of the arrays, sorted."""
        return sorted(name[: -len("/zarr.json")] for name in self.manifest["files"] if name.endswith("/zarr.json"))

    def __contains__(self, name: object) -> bool:
        return f"{name}/zarr.json" in self.manifest["files"]

    def array(self, name: str) -> zarr.Array:
        """The array without reading it; slices are read and checked (crc32c) chunk by chunk. Raises ArtifactError for a wrong name."""
        if name not in self:
            raise ArtifactError(f"{self.path}: there is no array {name!r}; it has {', '.join(self.names()) or 'none'}")
        array: Any = self._group[name]
        return array

    def read(self, name: str) -> np.ndarray:
        """A whole array. Raises ArtifactError when a chunk is damaged."""
        array = self.array(name)
        try:
            data: Any = array[...]
        except (ValueError, RuntimeError, OSError) as error:
            raise ArtifactError(f"{self.path}: array {name!r} is damaged ({error}); run the stage again with --force") from error
        return data

    def verify(self) -> None:
        """Reads every byte and compares it with the manifest; raises ArtifactError that names the first damaged file."""
        try:
            digests = digest_files(self.path, self.manifest["files"])
        except OSError as error:
            raise ArtifactError(f"{self.path}: cannot be read ({error})") from error
        for name, (_, digest) in self.manifest["files"].items():
            if digests[name] != digest:
                raise ArtifactError(f"{self.path / name}: its content is not what was written; run the stage again with --force")
        if content_digest(self.manifest["files"]) != self.digest:
            raise ArtifactError(f"{self.path / MANIFEST}: the content digest does not match the files; run the stage again with --force")
