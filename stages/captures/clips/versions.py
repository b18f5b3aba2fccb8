"""Files of one clip in several sizes, looks or versions, of which one is read: their names are the same but for words as `_proxy`,
`_graded` and `_v2`."""

from __future__ import annotations

import posixpath
import re
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..video.survey import Survey
from .seen import first_pictures, look_alike

_WORD = re.compile(
    r"(.+?)(?:[-_ .]?(?:(?P<small>proxy|preview|lowres|small)|(?P<lines>(?<!\d)\d{3,4}p)|(?P<altered>graded|vis|stab(?:ili[sz]ed)?)"
    r"|copy|src|input)"
    r"|[-_ .](?:(?P<also>grade|edit(?:ed)?)|orig(?:inal)?|raw|full(?:res)?|hires|v(?P<version>\d{1,3})))"
)
_ALIKE = 0.01  # of the number of frames


class _Named(NamedTuple):
    """What the name of a video says. clip: the rest of it. version: None without one."""

    clip: str
    small: bool
    lines: bool
    altered: bool
    version: int | None


def older(root: Path, headers: Mapping[str, Survey]) -> dict[str, str]:
    """Those videos that are the clip of another one, and that one. One that is called smaller never stays beside another; else what the
    camera saw stays, then the larger picture, the later version, and the larger file. Their numbers of frames are within 1 %, and those
    of different version numbers, which may be views, look alike."""
    named = {name: _named(name) for name in headers}
    clips: dict[str, list[str]] = {}
    for name in headers:
        clips.setdefault(named[name].clip, []).append(name)

    @lru_cache(None)
    def seen(name: str) -> np.ndarray:
        return first_pictures(root, name)

    def same(name: str, other: str) -> bool:
        counts = len(headers[name].seconds), len(headers[other].seconds)
        close = abs(counts[0] - counts[1]) <= _ALIKE * max(counts)
        return close and (named[name].version == named[other].version or look_alike(seen(name), seen(other)))

    found: dict[str, str] = {}
    for clip in clips.values():
        most = max(_area(headers[name]) for name in clip)

        def rank(name: str, most: int = most) -> tuple[float, ...]:
            said, area = named[name], _area(headers[name])
            small = said.small or (said.lines and area < most)
            looked_at = said.altered, said.version is not None
            return small, *looked_at, -area, -(said.version or 0), -(root / name).stat().st_size

        kept: list[str] = []
        for name in sorted(clip, key=rank):
            if (other := next((other for other in kept if same(name, other)), None)) is None:
                kept.append(name)
            else:
                found[name] = other
    return found


def told(found: Mapping[str, str], headers: Mapping[str, Survey]) -> tuple[str, ...]:
    """A line about each video that `older` has found."""
    return tuple(
        f"{name} ({_size(headers[name])}) is left out: by its name and its frames it is the same clip as {other} "
        f"({_size(headers[other])}), which is read; {_otherwise(headers[name], headers[other])}rename it if it is a camera of its own"
        for name, other in found.items()
    )


def _otherwise(header: Survey, other: Survey) -> str:
    return "to read it though, since it is larger, take the other one out; " if _area(header) > _area(other) else ""


def _named(name: str) -> _Named:
    """Takes words off the end of a name, as long as there are any."""
    rest, small, lines, altered = posixpath.splitext(name)[0].lower(), False, False, False
    version: int | None = None
    while match := _WORD.fullmatch(rest):
        rest = match[1]
        small |= match["small"] is not None
        lines |= match["lines"] is not None
        altered |= (match["altered"] or match["also"]) is not None
        version = int(match["version"]) if match["version"] and version is None else version
    return _Named(rest, small, lines, altered, version)


def _area(header: Survey) -> int:
    return header.width * header.height


def _size(header: Survey) -> str:
    return f"{header.width}x{header.height}"
