"""What a terminal, a log or a pipe can take: the letters of its encoding, and tables of some width."""

from __future__ import annotations

import codecs
import os
import sys

from rich.console import Console

WIDTH = 1000  # columns of a file or pipe: more than any row of a table has, so that each stays one line that can be searched for
ESCAPES = "e4dgs.escapes"  # name of the error handler of streams


def make_console() -> Console:
    """A console for tables: as wide as the terminal, and elsewhere as the environment's COLUMNS says, or `WIDTH`."""
    console = Console()
    return console if console.is_terminal or os.environ.get("COLUMNS", "").isdigit() else Console(width=WIDTH)


def write_any_letter() -> None:
    """From now on standard output and errors write a letter that their encoding lacks as ``\\u00b2``: after hours of work no command
    fails at its last line, and JSON stays valid."""
    codecs.register_error(ESCAPES, _escapes)
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors=ESCAPES)


def _escapes(error: UnicodeError) -> tuple[str, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    units = error.object[error.start : error.end].encode("utf-16-be", "surrogatepass")  # as in JSON, two escapes above U+FFFF
    return "".join(f"\\u{units[k : k + 2].hex()}" for k in range(0, len(units), 2)), error.end
