"""Several video files of one recording, which are no cameras of one event: the chapters that a camera splits a long recording into, and
files of one clip in two sizes."""

from __future__ import annotations

import posixpath
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

from ....pipeline import CaptureError
from ..video import timecode
from ..video.probe import Header

# GoPro: GX010034 and GX020034, before HERO6 GOPR0034 and GP010034; the last four digits count the recordings
_CHAPTER = re.compile(r"(?:(G[HXLS])(\d\d)|(G)(?:OPR|P(\d\d)))(\d{4})", re.IGNORECASE)
_JOIN = "ffmpeg -f concat -safe 0 -i list.txt -c copy all.mp4 (list.txt has a line for each, in order: file 'NAME'), and pass all.mp4"
_SMALLER = re.compile(r"(.+?)[-_ ]?(?:proxy|preview|lowres|small|copy)")
_ALIKE = 0.01  # of the number of frames


def smaller(root: Path, headers: Mapping[str, Header]) -> dict[str, str]:
    """Those videos that are the clip of another one, and that one: the larger picture stays, of two equal ones the larger file. Their names
    are the same but for the suffix and for words as `_proxy`, and their numbers of frames are within 1 %."""
    clips: dict[str, list[str]] = {}
    for name in headers:
        stem = posixpath.splitext(name)[0].lower()
        match = _SMALLER.fullmatch(stem)
        clips.setdefault(match[1] if match else stem, []).append(name)
    found: dict[str, str] = {}
    for clip in clips.values():
        kept: list[str] = []
        for name in sorted(clip, key=lambda name: (-headers[name].width * headers[name].height, -(root / name).stat().st_size)):
            count = len(headers[name].seconds)
            same = (other for other in kept if abs(len(headers[other].seconds) - count) <= _ALIKE * max(len(headers[other].seconds), count))
            if (other := next(same, None)) is None:
                kept.append(name)
            else:
                found[name] = other
    return found


def told(found: Mapping[str, str], headers: Mapping[str, Header]) -> tuple[str, ...]:
    """A line about each video that `smaller` has found."""
    return tuple(
        f"{name} ({_size(headers[name])}) is left out: by its name and its frames it is the same clip as {other} ({_size(headers[other])})"
        "; rename it if it is a camera of its own"
        for name, other in found.items()
    )


def _size(header: Header) -> str:
    return f"{header.width}x{header.height}"


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


def follow_each_other(headers: Mapping[str, Header]) -> tuple[str, ...]:
    """A line if by the timecodes one video begins when another one has ended. It is no more than a hint: clocks of cameras may be wrong."""
    names, videos = list(headers), list(headers.values())
    found = timecode.apart([h.timecode for h in videos], [h.fps for h in videos], [h.seconds[-1] + h.late for h in videos])
    if found is None:
        return ()
    before, after = names[found[0]], names[found[1]]
    return (
        f"by their timecodes {after} ({headers[after].timecode}) follows {before} ({headers[before].timecode}), so they may be parts of "
        f"one recording: if so, join them: {_JOIN}; frames.sync=frames says that they are cameras",
    )
