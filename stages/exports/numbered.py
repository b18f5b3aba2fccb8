"""Numbered files of an export, one per time: ``frame0001.ply`` and so on."""

from __future__ import annotations

import re
from pathlib import Path


def numbered(folder: Path, k: int, ending: str) -> Path:
    """The file of time ``k``, from 0, with an ending such as ``.ply``."""
    return folder / f"frame{k + 1:04d}{ending}"


def remove_later(folder: Path, count: int, ending: str) -> None:
    """Removes the files that an earlier export of more than ``count`` times has left, or programs would play them after the new ones.

    Only files with exactly such a name go. Raises OSError if one cannot be removed.
    """
    name = re.compile(rf"frame([0-9]{{4,}}){re.escape(ending)}")
    for file in sorted(folder.iterdir()):
        found = name.fullmatch(file.name)
        if found is not None and int(found[1]) > count and file == numbered(folder, int(found[1]) - 1, ending) and file.is_file():
            file.unlink()
