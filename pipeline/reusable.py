"""An earlier result of a stage, of which unchanged items are reused."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from .storage.artifact import Artifact


@dataclass(frozen=True)
class Earlier:
    """A result with the same code and settings, held for the lifetime of this object. ``rows`` maps the index of an item in the result
    to be made to its index in this one. ``total``: number of items in the result to be made."""

    artifact: Artifact
    rows: Mapping[int, int]
    total: int

    @property
    def new(self) -> int:
        """Number of items that have to be computed."""
        return self.total - len(self.rows)
