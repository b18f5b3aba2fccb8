"""Lines for people."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console


def say(*lines: str, to: Console | None = None) -> None:
    """Prints lines as they are: what they quote is no markup, and nothing is coloured or cut. to: by default the standard output."""
    from rich.console import Console

    for line in lines:
        (to or Console()).print(line, markup=False, highlight=False, soft_wrap=True)
