"""The source files of some packages: the digest of each, and which files it imports or includes."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import NamedTuple

from ..files import canonical_json, digest_bytes
from .native_source import CPU, CUDA, NativeSource
from .package import Package
from .parse_cache import ParseCache
from .python_source import PythonSource


class File(NamedTuple):
    """``name``: path within the package, or the full path of a file in no package. ``compiled``: the file as the build compiled it."""

    package: str
    name: str
    compiled: bool = False


class Sources:
    """Every file is read only when needed, and only once. ``without``: a package whose files do not count."""

    def __init__(self, packages: Mapping[str, Package], without: str) -> None:
        self.packages, self._without = packages, without
        self._parsed = ParseCache()
        self._python: dict[File, PythonSource] = {}
        self._native: dict[File, NativeSource] = {}
        self._leads: dict[File, tuple[list[File], list[File]]] = {}
        self.state = cache(self._state)

    def save(self) -> None:
        self._parsed.save()

    def digest(self, file: File) -> str:
        """Digest of a file's code, "" if it has none."""
        return self._of_native(file).digest if _is_native(file) else self._of_python(file).digest

    def leads(self, file: File) -> list[File]:
        """The files that a file imports or includes, and the package files that Python runs on the way to them."""
        return self._found(file)[1]

    def _state(self, file: File, depth: int = 2) -> str:
        """The digest of a file combined with the digests of the files it imports from by relative imports. The file's own digest leaves
        out the module of a relative import, so that a file may move. Goes two levels deep, so that files that only re-export names are
        told apart by where the names come from."""
        if depth == 0 or _is_native(file):
            return self.digest(file)
        return digest_bytes(canonical_json([self.digest(file), *(self.state(to, depth - 1) for to in self._found(file)[0])]))

    def module(self, top: str, parts: Sequence[str], runs: bool = False) -> list[File]:
        """The file of a module followed by those of the packages that contain it; [] if there is none. runs: include the ``__main__``
        module of a package, because a package that is imported by itself may be run as a program."""
        package = self.packages[top]
        name = package.module(tuple(parts))
        if name is None or f"{'.'.join([top, *parts])}.".startswith(f"{self._without}."):
            return []
        found = [name, *(package.module(tuple(parts[:k])) for k in range(len(parts)))]
        if runs and name.endswith("__init__.py"):
            found.append(package.module((*parts, "__main__")))
        return [File(top, one) for one in found if one]

    def cuda_beside(self, file: File) -> list[File]:
        """The CUDA sources in a file's folder. They are compiled at run time."""
        if file.package not in self.packages:
            return []
        folder = os.path.dirname(file.name)
        names = self.packages[file.package].native
        return [File(file.package, name) for name in names if name.endswith(CUDA) and os.path.dirname(name) == folder]

    def _of_python(self, file: File) -> PythonSource:
        if file not in self._python:
            path = self.packages[file.package].path(file.name) if file.package else Path(file.name)
            assert path is not None
            self._python[file] = self._parsed.python(path.read_bytes())
        return self._python[file]

    def _of_native(self, file: File) -> NativeSource:
        if file not in self._native:
            package = self.packages[file.package]
            path, listed = package.path(file.name), package.listed.get(file.name) if file.compiled else None
            if listed is None:
                assert path is not None
                data = path.read_bytes()
                listed = self._parsed.native(file.name, data) if file.name.endswith((*CPU, *CUDA)) else NativeSource(digest_bytes(data))
            self._native[file] = listed
        return self._native[file]

    def _found(self, file: File) -> tuple[list[File], list[File]]:
        """The Python files that a file imports from by relative imports, in order, and all the files that it leads to."""
        if file not in self._leads:
            self._leads[file] = self._included(file) if _is_native(file) else self._imported(file)
        return self._leads[file]

    def _included(self, file: File) -> tuple[list[File], list[File]]:
        package = self.packages[file.package]
        names = (package.included(name, file.name) for name in self._of_native(file).includes)
        return [], [File(file.package, name, file.compiled) for name in names if name is not None]

    def _imported(self, file: File) -> tuple[list[File], list[File]]:
        package = [file.package, *file.name.split("/")[:-1]] if file.package else []
        relative: list[File] = []
        leads: dict[File, None] = {}
        for level, module, names in self._of_python(file).imports:
            base = package[: len(package) - level + 1] if level else []
            if level and not base:
                continue  # there is no enclosing package that the import could be relative to
            targets, around = self._import([*base, *filter(None, module.split("."))], names)
            relative += [one for one in targets if level and not _is_native(one)]
            leads |= dict.fromkeys((*targets, *around))
        return relative, list(leads)

    def _import(self, module: list[str], names: Sequence[str]) -> tuple[list[File], list[File]]:
        """The files that ``from module import names`` refers to, and those that run on the way. Both are empty for third-party modules."""
        top, *parts = module or [""]
        if top not in self.packages:
            return [], []
        itself = self.module(top, parts, runs=not names)
        if not itself and parts and not self.packages[top].is_folder(parts):
            return self._compiled(top, parts[:-1], parts[-1]), self.module(top, parts[:-1])
        if not names or (itself and not itself[0].name.endswith("__init__.py")):
            return itself[:1], itself[1:]
        found = [self._member(top, parts, name, itself) for name in names]
        return [one for targets, _ in found for one in targets], [*itself, *(one for _, around in found for one in around)]

    def _member(self, top: str, parts: list[str], name: str, itself: list[File]) -> tuple[list[File], list[File]]:
        """The files that a name in a package refers to: a module in it, a lazily imported name, a compiled module, or the package's own
        file."""
        if inner := self.module(top, [*parts, name], runs=True):
            return inner[:1], inner[1:]
        source = self._of_python(itself[0]) if itself else PythonSource("")
        if name in source.names:
            return itself[:1], []
        if name in source.later:
            return self._import([top, *parts, *filter(None, source.later[name].split("."))], [name])
        targets = self._compiled(top, parts, name)
        if not targets and "__getattr__" in source.names:  # the name may come from any module of the package
            targets = [File(top, one) for one in self.packages[top].below(parts)]
        return targets or itself[:1], []

    def _compiled(self, top: str, parts: list[str], name: str) -> list[File]:
        """The sources that a compiled module is built from or, if they are unknown, the module itself."""
        package = self.packages[top]
        return [File(top, one, True) for one in package.sources(parts) or package.compiled(parts, name)]


def _is_native(file: File) -> bool:
    return not file.name.endswith(".py")
