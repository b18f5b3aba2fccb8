"""The unit of compilation: a .cu file with its features and headers, and a digest of all of them."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from functools import cache
from pathlib import Path

CUDA = Path(__file__).resolve().parents[1]
INCLUDES = (CUDA.parent / "math", CUDA)  # headers that any kernel may use
HEADERS = (".h", ".cuh")


@dataclass(frozen=True)
class Program:
    """A .cu file that is compiled with these features and header folders into one loadable module.

    source: the file. Its kernels are declared `extern "C" __global__` and found by their plain names.
    defines: preprocessor names and their values, e.g. (("SH_DEGREE", 3),). Their order does not affect the digest.
    includes: folders to search for headers; the first match wins. The source's own folder is always searched first.
    """

    source: Path
    defines: tuple[tuple[str, int], ...] = ()
    includes: tuple[Path, ...] = INCLUDES

    def __post_init__(self) -> None:
        object.__setattr__(self, "_hash", hash((self.source, self.defines, self.includes)))

    def __hash__(self) -> int:  # asked for by every launch
        return int(vars(self)["_hash"])

    def __str__(self) -> str:
        return " ".join([self.source.name, *(f"{name}={value}" for name, value in sorted(self.defines))])


@cache
def digest(program: Program) -> str:
    """Hex digest of everything a program consists of: its source, every header it could include, and its defines.

    File names are relative to their folder, so the same installation in another place has the same digest. Computed once per
    process and program, so edits take effect at the next start. Raises OSError if the source or a header cannot be read.
    """
    parts = [program.source.name.encode(), program.source.read_bytes()]
    for name, value in sorted(program.defines):
        parts += b"define", name.encode(), str(value).encode()
    return _of(*parts, *map(_headers, (program.source.parent, *program.includes))).hex()


@cache
def _headers(folder: Path) -> bytes:
    """Digest of the headers in ``folder``, which many programs share."""
    found = (path for path in sorted(folder.rglob("*")) if path.suffix in HEADERS and path.is_file())
    return _of(*(part for path in found for part in (path.relative_to(folder).as_posix().encode(), path.read_bytes())))


def _of(*parts: bytes) -> bytes:
    state = hashlib.blake2b(digest_size=20)
    for part in parts:
        state.update(len(part).to_bytes(8, "little") + part)
    return state.digest()
