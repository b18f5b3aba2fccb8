"""Options of other kinds of export that mean nothing for one: they are refused with the reason."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Annotated, Any

import typer

from ...pipeline import SettingsError

FLAGS = ("antialiased",)


def without(**reasons: str) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Lets a command refuse options by name, each with its reason, in place of saying that there is no such option."""

    def wrap(command: Callable[..., None]) -> Callable[..., None]:
        def run(**given: Any) -> None:
            for name, reason in reasons.items():
                if given.pop(name) not in (None, False):
                    raise SettingsError(f"--{name}: {reason}")
            command(**given)

        own = inspect.signature(command, eval_str=True)
        more = [
            inspect.Parameter(
                name,
                inspect.Parameter.KEYWORD_ONLY,
                default=False if name in FLAGS else None,
                annotation=Annotated[bool if name in FLAGS else str | None, typer.Option(f"--{name}", hidden=True)],
            )
            for name in reasons
        ]
        run.__name__, run.__doc__, run.__module__ = command.__name__, command.__doc__, command.__module__
        given = [one.replace(kind=inspect.Parameter.KEYWORD_ONLY) for one in own.parameters.values()]
        run.__signature__ = inspect.Signature([*given, *more])  # type: ignore[attr-defined]
        run.__annotations__ = {one.name: one.annotation for one in (*given, *more)}
        return run

    return wrap
