"""The files of a package: which file a module is, and which sources a compiled module was built from."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Sequence
from functools import cache, cached_property
from importlib.machinery import EXTENSION_SUFFIXES
from pathlib import Path

from .native_source import CPU, LIST, NativeSource, native_files


class Package:
    """``folders``: the folders of a top-level package, in the order in which Python searches them. An editable install has two.

    Files are named by their path in the package (``vision/flow/method.py``), modules by the parts of their name (``("vision", "flow")``).
    """

    def __init__(self, folders: Iterable[Path]) -> None:
        self.folders = list(folders)
        self.path = cache(self._path)  # lookups are remembered for the lifetime of this object
        self.module = cache(self._module)
        self._names = cache(self._list)

    def _path(self, file: str) -> Path | None:
        """The full path of a file, or None if there is no such file."""
        folder, _, name = file.rpartition("/")
        return next((Path(place, name) for place, names in self._names(folder) if name in names), None)

    def _list(self, folder: str) -> list[tuple[str, frozenset[str]]]:
        """The full paths of a folder of the package, each with the names it contains."""
        around, _, name = folder.rpartition("/")
        inner = [os.path.join(place, name) for place, names in self._names(around) if name in names] if folder else []
        places = inner if folder else [str(place) for place in self.folders]
        return [(place, frozenset(os.listdir(place))) for place in places if os.path.isdir(place)]

    def _module(self, parts: tuple[str, ...]) -> str | None:
        """The file of a module, or the ``__init__.py`` of a package. None if there is none."""
        inner, plain = "/".join((*parts, "__init__.py")), f"{'/'.join(parts)}.py"
        return inner if self.path(inner) else plain if parts and self.path(plain) else None

    def is_folder(self, parts: Sequence[str]) -> bool:
        return bool(self._names("/".join(parts)))

    def below(self, parts: Sequence[str]) -> list[str]:
        """All Python files of a package and its subpackages."""
        found = {path.relative_to(folder) for folder in self.folders for path in folder.joinpath(*parts).rglob("*.py")}
        return sorted(path.as_posix() for path in found)

    def compiled(self, parts: Sequence[str], name: str) -> list[str]:
        """The file of a compiled module in a package, or [] if there is none."""
        return [file for end in EXTENSION_SUFFIXES if self.path(file := "/".join((*parts, name + end)))][:1]

    @cached_property
    def listed(self) -> dict[str, NativeSource]:
        """The build's list of the sources it compiled. {} if nothing was built, or if the build wrote no list."""
        path = self.path(LIST)
        return {file: NativeSource(**found) for file, found in json.loads(path.read_bytes()).items()} if path else {}

    @cached_property
    def native(self) -> list[str]:
        """All C++ and CUDA sources in the subpackages of this package."""
        found = set(self.listed)
        for folder in self.folders:
            for inner in folder.iterdir():
                if (inner / "__init__.py").is_file():
                    found.update(f"{inner.name}/{file}" for file in native_files(inner))
        return sorted(found)

    def sources(self, parts: Sequence[str]) -> list[str]:
        """The sources, below the given subpackage, that its compiled modules are built from."""
        known = self.listed or self.native  # sources that are not in the build's list were not compiled, so they cannot run
        return [file for file in known if parts and file.startswith("/".join(parts) + "/") and file.endswith(CPU)]

    def included(self, name: str, by: str) -> str | None:
        """The file that ``by`` includes under ``name``: first searched beside ``by``, then anywhere in this package."""
        beside = os.path.normpath(os.path.join(os.path.dirname(by), name))
        return beside if beside in self.native else next((file for file in self.native if file.endswith(f"/{name}")), None)
