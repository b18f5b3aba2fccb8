"""Keeps the parsed form of source files on disk. Parsing a few hundred of them would take most of a second at each start."""

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

PYTHON = "python{}.{}".format(*sys.version_info)  # an older version may fail to parse what a newer one accepts
MOST = 5000  # files to remember; beyond that, the oldest entries are dropped


class ParseCache:
    """A cache of parsed sources. Entries are found by the digest of a file's content, never by its name or modification time. If the cache
    file is damaged or its folder cannot be used, that is not an error: everything is parsed again."""

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
        """Writes the cache file if anything was parsed since it was last written."""
        if not self._new or self._known is None or (path := cache_file()) is None:
            return
        self._new = False
        with suppress(OSError):  # the files are parsed again next time
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


def cache_folder() -> Path | None:
    """Folder of what is kept between runs: $E4DGS_CACHE, or else e4dgs/ below $XDG_CACHE_HOME or ~/.cache. None if there is no home folder
    either."""
    chosen, base = os.environ.get("E4DGS_CACHE"), os.environ.get("XDG_CACHE_HOME", "")
    try:
        return Path(chosen).expanduser() if chosen else (Path(base) if os.path.isabs(base) else Path.home() / ".cache") / "e4dgs"
    except RuntimeError:
        return None


def cache_file() -> Path | None:
    """The file of this cache. None if there is no folder for it."""
    folder = cache_folder()
    return folder / "sources.json" if folder is not None else None


def _load() -> dict[str, dict[str, Any]]:
    path = cache_file()
    with suppress(OSError, ValueError):
        digest, _, content = (path.read_bytes() if path else b"").partition(b"\n")
        if digest_bytes(content) == digest.decode() and (found := json.loads(content))["by"] == _readers():
            return found["files"]
    return {}


def _readers() -> str:
    """Digest of the code that turns a file into its entry here."""
    here = Path(__file__).parent
    return digest_bytes((here / "python_source.py").read_bytes() + (here / "native_source.py").read_bytes())
