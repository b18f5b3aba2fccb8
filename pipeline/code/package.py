"""A package as files: which file a module is, and which sources a compiled module was made of."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Sequence
from functools import cache, cached_property
from importlib.machinery import EXTENSION_SUFFIXES
from pathlib import Path

from .native_source import CPU, LIST, NativeSource, native_files


class Package:
    """``folders``: where a top-level package lies, in the order in which Python looks; an editable install has two.

    Files are called by their path below it, ``vision/flow/method.py``, modules by the parts of their name, ``("vision", "flow")``.
    """

    def __init__(self, folders: Iterable[Path]) -> None:
        self.folders = list(folders)
        self.path = cache(self._path)  # what is found stays so, as long as this lives
        self.module = cache(self._module)
        self._names = cache(self._list)

    def _path(self, file: str) -> Path | None:
        """Where a file lies; None where there is none."""
        folder, _, name = file.rpartition("/")
        return next((Path(place, name) for place, names in self._names(folder) if name in names), None)

    def _list(self, folder: str) -> list[tuple[str, frozenset[str]]]:
        """The places where a folder lies, and what is in them."""
        around, _, name = folder.rpartition("/")
        inner = [os.path.join(place, name) for place, names in self._names(around) if name in names] if folder else []
        places = inner if folder else [str(place) for place in self.folders]
        return [(place, frozenset(os.listdir(place))) for place in places if os.path.isdir(place)]

    def _module(self, parts: tuple[str, ...]) -> str | None:
        """The file of a module; of a package its ``__init__.py``. None where there is none."""
        inner, plain = "/".join((*parts, "__init__.py")), f"{'/'.join(parts)}.py"
        return inner if self.path(inner) else plain if parts and self.path(plain) else None

    def is_folder(self, parts: Sequence[str]) -> bool:
        return bool(self._names("/".join(parts)))

    def below(self, parts: Sequence[str]) -> list[str]:
        """All Python files of a package and of those in it."""
        found = {path.relative_to(folder) for folder in self.folders for path in folder.joinpath(*parts).rglob("*.py")}
        return sorted(path.as_posix() for path in found)

    def compiled(self, parts: Sequence[str], name: str) -> list[str]:
        """The file of a compiled module in a package; [] where there is none."""
        return [file for end in EXTENSION_SUFFIXES if self.path(file := "/".join((*parts, name + end)))][:1]

    @cached_property
    def listed(self) -> dict[str, NativeSource]:
        """What the build wrote down of the sources that it compiled; {} where nothing was built, or by a build that writes no list."""
        path = self.path(LIST)
        return {file: NativeSource(**found) for file, found in json.loads(path.read_bytes()).items()} if path else {}

    @cached_property
    def native(self) -> list[str]:
        """All C++ and CUDA sources in the packages in this one."""
        found = set(self.listed)
        for folder in self.folders:
            for inner in folder.iterdir():
                if (inner / "__init__.py").is_file():
                    found.update(f"{inner.name}/{file}" for file in native_files(inner))
        return sorted(found)

    def sources(self, parts: Sequence[str]) -> list[str]:
        """What the compiled modules of a package in this one are made of, as far as it lies below that package."""
        known = self.listed or self.native  # what has not been built yet does not run yet
        return [file for file in known if parts and file.startswith("/".join(parts) + "/") and file.endswith(CPU)]

    def included(self, name: str, by: str) -> str | None:
        """The file that another one includes under a name: from its own folder, else from anywhere in this package."""
        beside = os.path.normpath(os.path.join(os.path.dirname(by), name))
        return beside if beside in self.native else next((file for file in self.native if file.endswith(f"/{name}")), None)
