"""`e4dgs gc`: drop what no scene refers to."""

from __future__ import annotations

from typing import Annotated

import typer
from rich.console import Console

from ..pipeline import Store, collect, unused
from .amounts import bytes_of, megabytes, seconds_of
from .options import Debug, Workspace
from .session import DEFAULT_WORKSPACE
from .stored import users
from .writable import writing_to


def gc(
    workspace: Workspace = DEFAULT_WORKSPACE,
    keep_bytes: Annotated[
        str | None, typer.Option("--keep-bytes", metavar="SIZE", help="Only as much as it takes to have at most this, as 10G.")
    ] = None,
    older_than: Annotated[
        str | None, typer.Option("--older-than", metavar="AGE", help="Only what was last used so long ago, as 30d; old checkpoints, too.")
    ] = None,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Say what would be removed, remove nothing.")] = False,
    debug: Debug = False,
) -> None:
    """Remove results that no scene's last run used and no pin keeps, and what dead runs and damage have left. Runs may go on meanwhile."""
    workspace = workspace.resolve()
    store = Store(workspace / "store")
    most = bytes_of("--keep-bytes", keep_bytes) if keep_bytes is not None else None
    age = seconds_of("--older-than", older_than) if older_than is not None else None

    def live() -> dict[tuple[str, str], tuple[str, ...]]:
        return users(workspace)

    if not store.root.is_dir():
        _say("0 results, 0.0 MB")
        return
    if dry_run:
        items, total = unused(store, live, most, age)
        left = total - sum(item.size for item in items)
    else:
        with writing_to(workspace):
            found = collect(store, live, most, age)
        items, left = found.removed, found.left
        for item in found.busy:
            _say(f"left {item.name}: a process uses it")
    for item in items:
        _say(f"{'would remove' if dry_run else 'removed'} {item.name} ({megabytes(item.size)})")
    results = [item for item in items if item.key]
    _say(f"{len(results)} results, {megabytes(sum(item.size for item in results))}; {megabytes(left)} are left")
    if most is not None and left > most:
        _say("what is left is in use, pinned, too new, or of scenes' last runs; remove a folder under scenes/ to let go of that scene's")


def _say(message: str) -> None:
    Console().print(message, markup=False, highlight=False, soft_wrap=True)
