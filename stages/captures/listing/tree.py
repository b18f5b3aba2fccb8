"""All files of a capture's folder, by their names alone, within bounds."""

from __future__ import annotations

import os
from collections import deque
from dataclasses import dataclass
from pathlib import Path

MOST_FILES = 100_000
MOST_DEEP = 8  # folders within one another


@dataclass(frozen=True)
class Tree:
    """files: paths relative to the folder, with `/`, folder by folder, those near the top first. whole: whether these are all."""

    files: list[str]
    whole: bool


def tree(root: Path) -> Tree:
    """The files in `root` and its folders. Leaves out hidden files, and folders that are no part of a capture (`is_foreign`). Links to
    folders are followed, but no folder is entered twice."""
    files: list[str] = []
    waiting: deque[tuple[str, int]] = deque([("", 0)])
    entered: set[tuple[int, int]] = set()
    whole = True
    while waiting:
        folder, deep = waiting.popleft()
        try:
            entries = list(os.scandir(root / folder))
            place = os.stat(root / folder)
        except OSError:  # nothing can be read from it
            continue
        if (place.st_dev, place.st_ino) in entered:
            continue
        entered.add((place.st_dev, place.st_ino))
        for entry in entries:
            if entry.name.startswith("."):
                continue
            path = f"{folder}/{entry.name}" if folder else entry.name
            if len(files) >= MOST_FILES or len(entered) + len(waiting) > MOST_FILES:
                return Tree(files, False)
            if not _is_folder(entry):
                files.append(path)
            elif deep >= MOST_DEEP:
                whole = False
            elif not is_foreign(root / path):
                waiting.append((path, deep + 1))
    return Tree(files, whole)


def _is_folder(entry: os.DirEntry[str]) -> bool:
    try:
        return entry.is_dir()
    except OSError:
        return False


def is_foreign(folder: Path) -> bool:
    """Whether a folder inside a capture is no part of it: what macOS packs into archives, or a workspace, which is created wherever a
    command runs. Looks only at its name and at two names in it."""
    return folder.name == "__MACOSX" or ((folder / "store").is_dir() and (folder / "scenes").is_dir())
