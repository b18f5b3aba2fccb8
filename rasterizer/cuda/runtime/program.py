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

    def __str__(self) -> str:
        return " ".join([self.source.name, *(f"{name}={value}" for name, value in sorted(self.defines))])


@cache
def digest(program: Program) -> str:
    """Hex digest of everything a program consists of: its source, every header it could include, and its defines.

    File names are relative to their folder, so the same installation in another place has the same digest. Computed once per
    process and program, so edits take effect at the next start. Raises OSError if the source or a header cannot be read.
    """
    state = hashlib.blake2b(digest_size=20)

    def add(*parts: bytes) -> None:
        for part in parts:
            state.update(len(part).to_bytes(8, "little") + part)

    add(program.source.name.encode(), program.source.read_bytes())
    for name, value in sorted(program.defines):
        add(b"define", name.encode(), str(value).encode())
    for folder in (program.source.parent, *program.includes):
        add(b"folder")
        for path in sorted(folder.rglob("*")):
            if path.suffix in HEADERS and path.is_file():
                add(path.relative_to(folder).as_posix().encode(), path.read_bytes())
    return state.hexdigest()
