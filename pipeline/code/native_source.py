"""The part of a C++, CUDA or CMake file that can affect a result: everything except comments and white space.

`python native_source.py ROOT FILE` writes a list with the digests and includes of the native sources of all packages in ROOT. The build
calls it, because an installed package has no C++ sources.
"""

from __future__ import annotations

import json
import os
import re
import sys
from dataclasses import asdict, dataclass, field
from pathlib import Path

from blake3 import blake3  # imports nothing from this package, because the build runs this file on its own

CPU = (".cpp", ".cc", ".c", ".h", ".hpp", ".inl", "CMakeLists.txt")  # name endings of the files that compiled modules are built from
CUDA = (".cu", ".cuh")
LIST = "native_sources.json"

_WORDS = re.compile(r"\"(?:\\.|[^\"\\])*\"|(?<!\w)'(?:\\.|[^'\\])*'|[\w.']+|[()\[\]{},;]|[^\w\s()\[\]{},;\"']+|\S", re.DOTALL)
_COMMENTS = re.compile(
    r"(?P<comment>//[^\n]*|/\*.*?\*/)"
    r"|R\"(?P<end>[^()\s\\]{0,16})\(.*?\)(?P=end)\"|\"(?:\\.|[^\"\\\n])*\"|(?<!\w)'(?:\\.|[^'\\\n])*'",
    re.DOTALL,
)
_CMAKE_COMMENTS = re.compile(r"(?P<comment>#[^\n]*)|\"(?:\\.|[^\"\\])*\"", re.DOTALL)
_INCLUDE = re.compile(r'^\s*#\s*include\s*"([^"]+)"', re.MULTILINE)


@dataclass(frozen=True)
class NativeSource:
    """``digest``: of the code, "" if there is none. ``includes``: the names in its ``#include "..."`` lines."""

    digest: str
    includes: list[str] = field(default_factory=list)


def read_native(name: str, data: bytes) -> NativeSource:
    """The `NativeSource` of a file with this name and content."""
    text = data.decode(errors="surrogateescape").replace("\\\r\n", "").replace("\\\n", "")
    cmake = name.endswith("CMakeLists.txt")
    text = (_CMAKE_COMMENTS if cmake else _COMMENTS).sub(lambda found: " " if found["comment"] else found[0], text)
    lines = []
    for line in text.splitlines():
        words = " ".join(_WORDS.findall(line))
        lines.append(f"\n{words}\n" if words.startswith("#") else f"{words} " if words else "")  # a directive ends with its line
    code = "".join(lines).strip()
    digest = blake3(code.encode(errors="surrogateescape")).hexdigest() if code else ""
    return NativeSource(digest, [] if cmake else _INCLUDE.findall(text))


def native_files(folder: Path) -> list[str]:
    """Relative paths of all native sources below a folder, sorted."""
    found = []
    for place, folders, files in os.walk(folder):
        folders[:] = [name for name in folders if not name.startswith((".", "__"))]
        found += [Path(place, name).relative_to(folder).as_posix() for name in files if name.endswith((*CPU, *CUDA))]
    return sorted(found)


def write_list(root: Path, target: Path) -> None:
    """Writes ``target``, a JSON file that maps the path of each native source of the packages in ``root`` to its `NativeSource`."""
    packages = [folder for folder in sorted(root.iterdir()) if (folder / "__init__.py").is_file()]
    files = {f"{package.name}/{name}": package / name for package in packages for name in native_files(package)}
    found = {name: asdict(read_native(name, path.read_bytes())) for name, path in files.items()}
    target.write_text(json.dumps(found, indent=0) + "\n")


if __name__ == "__main__":
    write_list(Path(sys.argv[1]), Path(sys.argv[2]))
