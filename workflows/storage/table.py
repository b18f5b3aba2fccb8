"""The table of `e4dgs store list`: every column where there is room, and the ones that matter most on a narrow terminal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from rich.cells import cell_len
from rich.table import Table

GAP = 2  # columns of the terminal between two columns of the table
NUMBERS = ("size", "took", "memory")
FOLDED = ("scenes", "pins")  # take as many lines as they need
NARROW = 12  # columns that a folded one gets at least
LEAVE_OUT = ("memory", "took", "pins", "scenes")  # in this order
SHORTER = {"made": "age"}  # what is shown instead before anything is left out


def fitted(rows: Sequence[Mapping[str, str]], titles: Sequence[str], width: int) -> tuple[Table, list[str]]:
    """(the table of ``rows`` for a terminal of ``width`` columns, titles of what is left out). titles: in their order; a column without
    values is left out without a word if there is no room. rows: the text of each title, and of what `SHORTER` puts in its place."""
    shown = list(titles)
    if _needed(rows, shown) > width:
        shown = [title for title in shown if title not in FOLDED or any(row[title] for row in rows)]
    if _needed(rows, shown) > width:
        shown = [SHORTER.get(title, title) for title in shown]
    missing = []
    for title in LEAVE_OUT:
        if title in shown and _needed(rows, shown) > width:
            shown.remove(title)
            missing.append(title)
    fits = _needed(rows, shown) <= width
    table = Table(box=None, pad_edge=False, padding=(0, GAP, 0, 0))
    for title in shown:
        table.add_column(
            title, no_wrap=fits and title not in FOLDED, overflow="fold", justify="right" if title in NUMBERS or title == "age" else "left"
        )
    for row in rows:
        table.add_row(*(row[title] for title in shown))
    return table, missing


def _needed(rows: Sequence[Mapping[str, str]], titles: Sequence[str]) -> int:
    """Columns of a terminal in which nothing is cut."""
    widths = [max([cell_len(title), *(cell_len(row[title]) for row in rows)]) for title in titles]
    least = [min(width, NARROW) if title in FOLDED else width for title, width in zip(titles, widths)]
    return sum(least) + GAP * (len(titles) - 1) + 1
