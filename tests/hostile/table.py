"""All cases, by name: `CASES`."""

from __future__ import annotations

from . import archive_cases, binary_cases, json_cases, name_cases, picture_cases, scan_cases, video_cases
from .case import Case

_ALL = [
    case for part in (json_cases, picture_cases, name_cases, archive_cases, binary_cases, scan_cases, video_cases) for case in part.cases()
]
CASES: dict[str, Case] = {case.name: case for case in _ALL}
assert len(CASES) == len(_ALL), "two cases have one name"
