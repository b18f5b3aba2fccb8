"""Pins protect results from garbage collection. Each pin is a named list of keys, stored as a file in the store."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from ..errors import ArtifactError, SettingsError
from ..files import read_json, write_json
from ..names import RULE, is_safe
from .store import Store


class Pins:
    """``pins/<name>.json`` of a store: ``{"results": [[stage, key], ...]}``."""

    def __init__(self, store: Store) -> None:
        self._store, self._folder = store, store.root / "pins"

    def add(self, name: str, results: Iterable[tuple[str, str]]) -> list[tuple[str, str]]:
        """Adds results to the pin ``name`` and returns everything that it now contains.

        Raises SettingsError if ``name`` is not a valid file name, ArtifactError if a result is not in the store; then nothing is added.
        """
        before = self.read(name)
        pinned = [*before, *(result for result in results if result not in before)]
        write_json(self._path(name), {"results": pinned})
        # Checked after the pin is written, because a collection reads the pins again after it has moved something away.
        gone = [f"{stage}/{key}" for stage, key in pinned if not self._store.has(stage, key)]
        if gone:
            if before:
                write_json(self._path(name), {"results": before})
            else:
                self.remove(name)
            raise ArtifactError(f"{self._store.root}: {', '.join(gone)} is not there, so {name} cannot be pinned; run it again")
        return pinned

    def remove(self, name: str) -> bool:
        """Removes a pin. Returns False if there is no such pin."""
        try:
            self._path(name).unlink()
        except FileNotFoundError:
            return False
        return True

    def read(self, name: str) -> list[tuple[str, str]]:
        """(stage, key) of the results pinned under a name. Raises ArtifactError if the file is not a list of results."""
        path = self._path(name)
        if not path.exists():
            return []
        content = read_json(path)
        try:
            return [(str(stage), str(key)) for stage, key in content["results"]]
        except (TypeError, KeyError, ValueError):
            raise ArtifactError(f"{path}: this is not a list of pinned results; remove the file, and pin {name} again") from None

    def _path(self, name: str) -> Path:
        if not is_safe(name):
            raise SettingsError(f"{name}: {RULE}")
        return self._folder / f"{name}.json"

    def names(self) -> list[str]:
        return sorted(path.stem for path in self._folder.glob("*.json"))

    def results(self) -> dict[tuple[str, str], list[str]]:
        """(stage, key) of every pinned result -> the names of its pins."""
        found: dict[tuple[str, str], list[str]] = {}
        for name in self.names():
            for result in self.read(name):
                found.setdefault(result, []).append(name)
        return found
