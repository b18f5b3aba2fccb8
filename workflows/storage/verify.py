"""`e4dgs store verify`: reads every result of the store again."""

from __future__ import annotations

import typer

from ...pipeline import say
from ..machine.writable import writing_to
from ..options import Debug, Workspace
from ..session import DEFAULT_WORKSPACE
from .stored import opened


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
