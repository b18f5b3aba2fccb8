"""The source files that a stage's `run` reaches, and one digest of them."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Mapping
from functools import cache
from pathlib import Path
from typing import Any

from ..errors import StageError
from ..files import canonical_json, digest_bytes
from ..stage import Stage
from .package import Package
from .sources import File, Sources

ENGINE = __name__.rpartition(".")[0].rpartition(".")[0]  # the pipeline package: decides when a stage runs, not what its arrays hold
DIGITS = 16  # digits kept of a file's digest; these only serve to name the files that changed
_FOUND: dict[tuple[type, bool], dict[str, Any]] = {}


def code_of(stage: type[Stage], cuda: bool = False) -> dict[str, Any]:
    """``digest`` of all source that a stage's run reaches, and ``files``: the digest of each file by name. Computed once per process.

    cuda: whether the stage runs on a GPU; then its CUDA kernels count too. Raises StageError for a stage that was not defined in a file.
    """
    if (stage, cuda) not in _FOUND:
        _FOUND[stage, cuda] = reached(stage, _sources(_packages(stage)), cuda)
    return _FOUND[stage, cuda]


def code_now(stage: type[Stage], cuda: bool = False) -> dict[str, Any]:
    """Like `code_of`, but for the current contents of the files."""
    return reached(stage, _sources.__wrapped__(_packages(stage)), cuda)


def sources_of(packages: Mapping[str, Iterable[str | Path]]) -> Sources:
    """The `Sources` of top-level packages, given the folders of each."""
    return Sources({name: Package([Path(one) for one in folders]) for name, folders in packages.items()}, without=ENGINE)


def _packages(stage: type[Stage]) -> frozenset[str]:
    """The top-level packages whose source is first-party: the stage's own, and the one that contains this engine."""
    return frozenset(name.partition(".")[0] for name in (ENGINE, _module(stage)))


@cache
def _sources(names: frozenset[str]) -> Sources:
    found = {name: getattr(sys.modules.get(name), "__path__", ()) for name in names}
    return sources_of({name: folders for name, folders in found.items() if folders})


def reached(stage: type[Stage], sources: Sources, cuda: bool = False) -> dict[str, Any]:
    """What `code_of` returns, computed from these sources."""
    ours = {*sources.packages, _module(stage).partition(".")[0]}
    pending = [file for one in stage.__mro__ if _module(one).partition(".")[0] in ours for file in _files_of(one, sources)]
    found: set[File] = set()
    while pending:
        file = pending.pop()
        if file not in found:
            found.add(file)
            pending += sources.leads(file)
            if cuda:
                pending += sources.cuda_beside(file)
    sources.save()
    own = _module(stage).partition(".")[0]
    digests = {file: digest for file in sorted(found) if (digest := sources.digest(file))}  # files without code do not count
    return {
        "digest": digest_bytes(canonical_json(sorted(sources.state(file) for file in digests))),
        "files": {_shown(file, own): digest[:DIGITS] for file, digest in digests.items()},
    }


def _files_of(one: type, sources: Sources) -> list[File]:
    """The file that defines a first-party class, and the files that Python runs before it. [] for classes of the engine."""
    top, *parts = _module(one).split(".")
    if f"{_module(one)}.".startswith(f"{ENGINE}."):
        return []
    path = getattr(sys.modules.get(one.__module__), "__file__", None)
    if path is None:
        raise StageError(f"{one.__qualname__}: its source is not in a file, so changes to it cannot be noticed; put it into a file")
    files = sources.module(top, parts) if top in sources.packages else []
    return files if files and Path(path).as_posix().endswith(files[0].name) else [File("", path)]


def _shown(file: File, own: str) -> str:
    """``scene/model.py``; a file of another package than the stage's own has that package's name in front."""
    return Path(file.name).name if not file.package else file.name if file.package == own else f"{file.package}/{file.name}"


def _module(one: type) -> str:
    """The name of a class's module, even when that module is run as a script."""
    spec = getattr(sys.modules.get(one.__module__), "__spec__", None)
    return spec.name if spec is not None else one.__module__
