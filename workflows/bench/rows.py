"""A row of the benchmark: something to measure, and the bars that it should meet."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from ...pipeline import Progress, SettingsError


@dataclass
class Check:
    """One number and its bar, if it has one. ``better`` says on which side of the bar it must be."""

    what: str
    value: float
    bar: float | None = None
    better: Literal["below", "above"] = "below"
    unit: str = "x"
    note: str = ""

    @property
    def passed(self) -> bool | None:
        """Whether the bar is met; None if there is none. NaN meets no bar."""
        if self.bar is None:
            return None
        return self.value <= self.bar if self.better == "below" else self.value >= self.bar


@dataclass
class Measured:
    """The result of a row. protocol: one sentence that says what was measured, including sizes. numbers: every timing and count behind the
    checks, as JSON values. table: rows of further numbers to print, under ``columns``."""

    protocol: str
    checks: list[Check] = field(default_factory=list)
    numbers: dict[str, Any] = field(default_factory=dict)
    columns: tuple[str, ...] = ()
    table: Sequence[tuple[str, ...]] = field(default_factory=list)


@dataclass
class Bench:
    """The user's options, passed to every row.

    scale: factor on the number of primitives, pixels and points; bars apply only at 1. seconds: time limit for all repeats of one contender
    together. garden, capture: files given on the command line. progress: of the row that is being measured.
    """

    scale: float = 1.0
    repeats: int = 7
    seconds: float = 20.0
    garden: Path | None = None
    capture: Path | None = None
    progress: Progress = field(default_factory=lambda: Progress(0, ""))

    def expect(self, parts: int) -> None:
        """Announces ``parts`` more calls of `tick`."""
        self.progress.total += parts

    def tick(self, note: str) -> None:
        """Reports that one of the expected parts is done."""
        self.progress.advance(note=note)

    def count(self, full: int, least: int = 1) -> int:
        """A number of primitives or points at this scale."""
        return max(least, round(full * self.scale))

    def size(self, width: int, height: int) -> tuple[int, int]:
        """An image's size in pixels with ``scale`` of its area."""
        side = min(1.0, self.scale**0.5)
        return max(32, round(width * side)), max(24, round(height * side))


@dataclass(frozen=True)
class Row:
    """A row: its name on the command line, a description, and the function that measures it."""

    name: str
    what: str
    measure: Callable[[Bench], Measured]


def choose(rows: Sequence[Row], names: str | None) -> list[Row]:
    """The rows named in a comma-separated list, in their own order; all for None. Raises SettingsError for an unknown name."""
    if names is None:
        return list(rows)
    known = [row.name for row in rows]
    wanted = [name.strip() for name in names.split(",") if name.strip()]
    for name in wanted:
        if name not in known:
            raise SettingsError(f"--rows {name}: there is no such row; rows: {', '.join(known)}")
    if not wanted:
        raise SettingsError(f"--rows names no row; rows: {', '.join(known)}")
    return [row for row in rows if row.name in wanted]
