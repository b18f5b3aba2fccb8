"""Looking after a workspace: digest everything again, drop what no scene refers to."""

from __future__ import annotations

import shutil
from pathlib import Path

from ..pipeline import Store
from ..pipeline.files import sizes
from .stored import users


def garbage(workspace: Path) -> list[tuple[str, str, int]]:
    """(stage, key, bytes) of results in the store that no scene refers to."""
    store = Store(workspace / "store")
    keep = users(workspace)
    return [(stage, key, sum(sizes(store.path(stage, key)).values())) for stage, key in store.entries() if (stage, key) not in keep]


def collect(workspace: Path) -> tuple[list[tuple[str, str, int]], list[str]]:
    """Removes the garbage and what dead runs left half-written; returns both lists. What a living process builds stays."""
    store = Store(workspace / "store")
    removed = [entry for entry in garbage(workspace) if store.remove(entry[0], entry[1])]
    for stage, _, _ in removed:
        folder = workspace / "store" / stage
        if folder.is_dir() and not any(folder.iterdir()):
            shutil.rmtree(folder, ignore_errors=True)
    return removed, store.sweep()
