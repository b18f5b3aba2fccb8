"""What source files count as, kept on disk: parsing a few hundred of them would take most of a second at each start."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import Any

from ..files import digest_bytes, write_atomically
from .native_source import NativeSource, read_native
from .python_source import PythonSource, read_python

PYTHON = "python{}.{}".format(*sys.version_info)  # an older one may not parse what a later one does
MOST = 5000  # files that are remembered; beyond it, those found first go


class KnownSources:
    """Found by the digest of a file's content, never by its name or time. A file of the cache that is damaged, or of a folder that cannot
    be used, is no error: then everything is parsed."""

    def __init__(self) -> None:
        self._known: dict[str, dict[str, Any]] | None = None
        self._new = False

    def python(self, data: bytes) -> PythonSource:
        found = self._get(PYTHON, data, lambda: asdict(read_python(data)))
        return PythonSource(
            found["digest"], [(level, module, names) for level, module, names in found["imports"]], found["names"], found["later"]
        )

    def native(self, name: str, data: bytes) -> NativeSource:
        kind = "cmake" if name.endswith(".txt") else "native"
        return NativeSource(**self._get(kind, data, lambda: asdict(read_native(name, data))))

    def save(self) -> None:
        """Writes what has been parsed since the last time, if anything."""
        if not self._new or self._known is None or (path := cache_file()) is None:
            return
        self._new = False
        with suppress(OSError):  # it is parsed again next time
            files = dict(list(self._known.items())[-MOST:])
            content = json.dumps({"by": _readers(), "files": files}, separators=(",", ":"))
            write_atomically(path, f"{digest_bytes(content.encode())}\n{content}")

    def _get(self, kind: str, data: bytes, read: Callable[[], dict[str, Any]]) -> dict[str, Any]:
        if self._known is None:
            self._known = _load()
        key = f"{kind} {digest_bytes(data)[:32]}"
        if key not in self._known:
            self._known[key] = read()
            self._new = True
        return self._known[key]


def cache_file() -> Path | None:
    """In $E4DGS_CACHE, else in e4dgs in $XDG_CACHE_HOME or ~/.cache, as compiled kernels are; None where there is no home either."""
    chosen, base = os.environ.get("E4DGS_CACHE"), os.environ.get("XDG_CACHE_HOME", "")
    try:
        folder = Path(chosen).expanduser() if chosen else (Path(base) if os.path.isabs(base) else Path.home() / ".cache") / "e4dgs"
    except RuntimeError:
        return None
    return folder / "sources.json"


def _load() -> dict[str, dict[str, Any]]:
    path = cache_file()
    with suppress(OSError, ValueError):
        digest, _, content = (path.read_bytes() if path else b"").partition(b"\n")
        if digest_bytes(content) == digest.decode() and (found := json.loads(content))["by"] == _readers():
            return found["files"]
    return {}


def _readers() -> str:
    """Digest of the code that says what a file counts as."""
    here = Path(__file__).parent
    return digest_bytes((here / "python_source.py").read_bytes() + (here / "native_source.py").read_bytes())
