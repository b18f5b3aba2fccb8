"""`e4dgs store`: what is in a workspace's store, how it was made, how results differ; what is kept, and what is removed."""

from __future__ import annotations

from collections.abc import Callable

import typer

from .store import diff, list_, pin, show_result, unpin
from .upkeep import gc, verify

COMMANDS: dict[str, Callable[..., None]] = {
    "list": list_,
    "show": show_result,
    "diff": diff,
    "gc": gc,
    "pin": pin,
    "unpin": unpin,
    "verify": verify,
}

app = typer.Typer(no_args_is_help=True, help="See, keep, check and remove the results in a workspace's store.")
for name, command in COMMANDS.items():
    app.command(name)(command)
