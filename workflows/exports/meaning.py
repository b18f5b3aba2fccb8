"""Options of other kinds of export that mean nothing for one: they are refused with the reason."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Annotated, Any

import typer

from ...pipeline import SettingsError
from ..options import seen_as

FLAGS = ("antialiased",)


def without(**reasons: str) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Lets a command refuse options by name, each with its reason, in place of saying that there is no such option."""

    def wrap(command: Callable[..., None]) -> Callable[..., None]:
        def run(**given: Any) -> None:
            for name, reason in reasons.items():
                if given.pop(name) not in (None, False):
                    raise SettingsError(f"--{name}: {reason}")
            command(**given)

        own = inspect.signature(command, eval_str=True).parameters.values()
        refused = [(name, bool, False) if name in FLAGS else (name, str | None, None) for name in reasons]
        return seen_as(
            run,
            command,
            [(one.name, one.annotation, one.default) for one in own]
            + [(name, Annotated[kind, typer.Option(f"--{name}", hidden=True)], default) for name, kind, default in refused],
        )

    return wrap
