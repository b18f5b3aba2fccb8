"""`e4dgs store gc` removes what no scene refers to, and `e4dgs store verify` reads every result again."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from ...pipeline import Store, collect, counted, say, unused
from ..machine.writable import writing_to
from ..options import Debug, Workspace
from ..session import DEFAULT_WORKSPACE
from .amounts import bytes_of, megabytes, seconds_of
from .caches import kept, remove
from .stored import opened, users


def gc(
    workspace: Workspace = DEFAULT_WORKSPACE,
    keep_bytes: Annotated[
        str | None, typer.Option("--keep-bytes", metavar="SIZE", help="Remove only until at most this much is left, for example 10G.")
    ] = None,
    older_than: Annotated[
        str | None,
        typer.Option("--older-than", metavar="AGE", help="Only what was last used this long ago, for example 30d; checkpoints, too."),
    ] = None,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Show what would be removed; remove nothing.")] = False,
    debug: Debug = False,
) -> None:
    """Remove results that no scene's last run used and no pin keeps, what archives were unpacked to and what was heard of videos (made
    again when it is missed), and what dead runs and damage have left. Runs may go on meanwhile."""
    # A run that came to nothing may have left caches alone.
    store = Store(workspace.resolve() / "store") if kept(workspace.resolve()) else opened(workspace)
    workspace = workspace.resolve()
    most = bytes_of("--keep-bytes", keep_bytes) if keep_bytes is not None else None
    age = seconds_of("--older-than", older_than) if older_than is not None else None

    live = partial(users, workspace)
    with writing_to(workspace):
        spared = _caches(workspace, store, most, age, dry_run)
    for_results = None if most is None else max(0, most - spared)
    if dry_run:
        items, total = unused(store, live, for_results, age)
        left = total - sum(item.size for item in items)
    elif store.root.is_dir():
        with writing_to(workspace):
            found = collect(store, live, for_results, age)
        items, left = found.removed, found.left
        for item in found.busy:
            say(f"left {item.name}: a process uses it")
    else:
        items, left = [], 0
    for item in items:
        say(f"{'would remove' if dry_run else 'removed'} {item.name} ({megabytes(item.size)})")
    results = [item for item in items if item.key]
    say(f"{counted(len(results), 'result')}, {megabytes(sum(item.size for item in results))}; {megabytes(left + spared)} are left")
    if most is not None and left + spared > most:
        say(
            "what is left is in use, pinned, too new, or belongs to a scene's last run; "
            "remove a folder under scenes/ to release the results of that scene"
        )


def verify(workspace: Workspace = DEFAULT_WORKSPACE, debug: Debug = False) -> None:
    """Digest every result in the store again; a damaged one is moved aside, to be made again by the next run. Exit code 1 for any."""
    store = opened(workspace)
    results = store.verify()
    damaged = [result for result in results if result[2]]
    for stage, key, problem in damaged:
        with writing_to(workspace.resolve()):
            place = store.quarantine_damaged(stage, key)
        then = f"moved to {place}; the next run makes it again" if place else "a process builds it now"
        say(f"{stage}: damaged: {problem}; {then}")
    say(f"{len(results) - len(damaged)} of {len(results)} results in {workspace} are as they were written")
    if damaged:
        raise typer.Exit(1)


def _caches(workspace: Path, store: Store, most: int | None, age: float | None, dry_run: bool) -> int:
    """Removes, or names, caches before any result is removed, since they are rebuilt within seconds. Returns the bytes of those that
    stay."""
    spared = sum(item.size for item in kept(workspace))
    results = 0 if most is None else unused(store, tuple)[1]
    for item in kept(workspace, age or 0.0):
        if most is not None and results + spared <= most:
            break
        if dry_run or remove(item):
            spared -= item.size
            say(f"{'would remove' if dry_run else 'removed'} {item.name} ({megabytes(item.size)})")
        else:
            say(f"left {item.name}: a process uses it")
    return spared
