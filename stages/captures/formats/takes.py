"""Several video files of one recording, which are no cameras of one event: the chapters that a camera splits a long recording into."""

from __future__ import annotations

import posixpath
import re
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from itertools import pairwise
from pathlib import Path

from ....pipeline import CaptureError
from ..video import timecode
from ..video.survey import Survey

# GoPro: GX010034 and GX020034, before HERO6 GOPR0034 and GP010034; the last four digits count the recordings
_CHAPTER = re.compile(r"(?:(G[HXLS])(\d\d)|(G)(?:OPR|P(\d\d)))(\d{4})", re.IGNORECASE)
_JOIN = "ffmpeg -f concat -safe 0 -i list.txt -c copy all.mp4 (list.txt has a line for each, in order: file 'NAME'), and pass all.mp4"
_CLOCK = 2.0  # s; dates of files are whole seconds, and cameras write them a little before or after the first picture
_SAME_RATE = 0.001


def refuse_chapters(root: Path, names: Sequence[str]) -> None:
    """Raises CaptureError, with the command that joins them, if the names of videos are those of chapters of one recording."""
    takes: dict[tuple[str, str], dict[int, str]] = {}
    for name in names:
        if (match := _CHAPTER.fullmatch(posixpath.splitext(name)[0])) is not None:
            kind, number = (match[1] or match[3]).upper(), int(match[2] or match[4] or 0)
            takes.setdefault((kind, match[5]), {}).setdefault(number, name)
    split = [[chapters[k] for k in sorted(chapters)] for chapters in takes.values() if len(chapters) > 1]
    if split:
        parts = ", ".join(split[0])
        others = f" ({len(split) - 1} more recordings are split like this)" if len(split) > 1 else ""
        raise CaptureError(
            f"{root}: by their names {parts} are chapters of one recording, one after the other, and no cameras{others}; join them: "
            f"{_JOIN}; --format videos reads them as cameras"
        )


def refuse_parts(root: Path, headers: Mapping[str, Survey]) -> None:
    """Raises CaptureError, as `refuse_chapters`, if videos of one size and rate begin where another one ends, by the dates in the files."""
    gaps = _gaps(headers)
    if gaps is None or max(gap for _, gap in gaps) > _CLOCK:
        return
    parts = ", ".join(name for name, _ in gaps)
    raise CaptureError(
        f"{root}: by the dates in the files {parts} are parts of one recording, one after the other, and no cameras; join them: {_JOIN}; "
        "--format videos reads them as cameras"
    )


def follow_each_other(headers: Mapping[str, Survey]) -> tuple[str, ...]:
    """A line if by the timecodes, or by the dates in the files, one video begins when another one has ended. It is no more than a hint:
    clocks of cameras may be wrong."""
    names, videos = list(headers), list(headers.values())
    found = timecode.apart([h.timecode for h in videos], [h.fps for h in videos], [h.seconds[-1] + h.late for h in videos])
    if found is not None:
        before, after = names[found[0]], names[found[1]]
        seen = f"their timecodes {after} ({headers[after].timecode}) follows {before} ({headers[before].timecode})"
    elif (gaps := _gaps(headers)) is not None:
        before, after = gaps[0][0], gaps[1][0]
        seen = f"the dates in the files {after} ({_date(headers[after])}) follows {before} ({_date(headers[before])})"
    else:
        return ()
    return (f"by {seen}, so they may be parts of one recording: if so, join them: {_JOIN}; frames.sync=frames says that they are cameras",)


def begun_apart(headers: Mapping[str, Survey]) -> tuple[str, ...]:
    """A line if, by the dates in the files, videos that are aligned by their first frames began at different moments. Dates may be those of
    the ends, so by neither reading may they begin together."""
    dates = [header.created for header in headers.values()]
    ends = [(date or 0.0) - header.seconds[-1] for date, header in zip(dates, headers.values(), strict=True)]
    if None in dates or (apart := min(max(found) - min(found) for found in (dates, ends))) <= _CLOCK:  # type: ignore[type-var, operator]
        return ()
    return (
        f"warning: by the dates in the files they begin up to {apart:.0f} s apart: if so, trim them to one moment, or give each its sound; "
        "frames.sync=frames says that they begin together",
    )


def _gaps(headers: Mapping[str, Survey]) -> list[tuple[str, float]] | None:
    """The videos in the order in which they were recorded, and the seconds that each begins after the end of the one before (0 for the
    first); None unless all have a date, one size and one rate, and none begins before another one has ended.

    Dates are those of the first picture or, with some cameras, of the last. One of the two readings is enough if by it each video begins
    where another one ends; longer gaps may be due to the wrong one, so both must have them. Where a video is hardly longer than the clock
    is unsure, nothing is known."""
    first = next(iter(headers.values()))
    ends: dict[str, tuple[float, float]] = {}
    for name, header in headers.items():
        alike = (header.width, header.height) == (first.width, first.height)
        if header.created is None or header.fps is None or first.fps is None or not alike:
            return None
        if abs(header.fps - first.fps) > _SAME_RATE * first.fps:
            return None
        ends[name] = (header.created, header.seconds[-1] + header.late + 1 / header.fps)
    order = sorted(ends, key=lambda name: ends[name][0])
    if any(ends[name][1] <= 2 * _CLOCK for name in order[:-1]):  # the last part may be short
        return None
    found: list[list[float]] = []
    for place in (0, 1):  # the date is that of the start, or of the end
        spans = [(ends[name][0] - place * ends[name][1], ends[name][0] + (1 - place) * ends[name][1]) for name in order]
        gaps = [begin - end for (_, end), (begin, _) in pairwise(spans)]
        if min(gaps) >= -_CLOCK:
            found.append([0.0, *gaps])
    best = min(found, key=max, default=None)
    known = best is not None and (len(found) == 2 or max(best) <= _CLOCK)
    return list(zip(order, best or [], strict=True)) if known else None


def _date(header: Survey) -> str:
    return datetime.fromtimestamp(header.created or 0, UTC).strftime("%Y-%m-%d %H:%M:%S")
