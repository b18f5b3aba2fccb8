"""The facts about a video that planning needs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from .survey import survey


@dataclass(frozen=True)
class Header:
    """Facts about a video: size as shown, time in seconds of every frame in display order, frame rate, and a line for every repair and
    for what is not read. late: seconds by which the first frame comes after the start of its track. timecode: of that start. created: when
    the file was made, in seconds of the clock of Unix, if it says; some cameras write the end of the recording."""

    width: int
    height: int
    seconds: tuple[float, ...]
    fps: float | None
    notes: tuple[str, ...] = ()
    late: float = 0.0
    timecode: str | None = None
    created: float | None = None


def probe(root: Path, name: str) -> Header:
    """Reads all packets, but decodes only the first frames. Raises CaptureError for broken and truncated files."""
    found = survey(root, name)
    return Header(*found.shape.shown, found.seconds, found.fps, found.notes, found.late, found.timecode, found.created)


def told_together(headers: Mapping[str, Header]) -> tuple[str, ...]:
    """The lines of several videos; one line for those that share it."""
    names: dict[str, list[str]] = {}
    for name, header in headers.items():
        for note in header.notes:
            names.setdefault(note, []).append(name)
    return tuple(f"{_listed(those)}: {note}" for note, those in names.items())


def _listed(names: list[str]) -> str:
    return ", ".join(names) if len(names) < 4 else f"{names[0]}, {names[1]} and {len(names) - 2} more"
