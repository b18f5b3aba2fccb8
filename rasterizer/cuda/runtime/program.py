"""What is compiled as one piece: a .cu file with its features and headers, and a digest of all of that."""

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
    """A .cu file, compiled with these features and folders of headers into one loadable piece.

    source: the file; its kernels are `extern "C" __global__`, found by their plain names.
    defines: preprocessor names and their values, e.g. (("SH_DEGREE", 3),); their order does not matter to the digest.
    includes: folders searched for headers, first match counts. The source's own folder is always searched before them.
    """

    source: Path
    defines: tuple[tuple[str, int], ...] = ()
    includes: tuple[Path, ...] = INCLUDES

    def __str__(self) -> str:
        return " ".join([self.source.name, *(f"{name}={value}" for name, value in sorted(self.defines))])


@cache
def digest(program: Program) -> str:
    """Hex digest of all that a program consists of: source, every header it could include, defines.

    Names count relative to their folder, so another place of the same installation has the same digest. Computed once per
    process and program: edits count from the next start on. Raises OSError where the source or a header cannot be read.
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
