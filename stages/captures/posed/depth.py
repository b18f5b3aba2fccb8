"""One line about depth that a scan has and that is not read, because it is of a kind that `depth_maps.py` does not find."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path


def told_depth(root: Path, names: Sequence[str], what: str = "no depth map belongs to a picture by its name") -> tuple[str, ...]:
    """A note for people about ``names``, files and folders relative to ``root``; none without names."""
    folders = [f"{name}/" for name in names if (root / name).is_dir()]
    files = [name for name in names if f"{name}/" not in folders]
    parts = [*folders, *([f"{files[0]}{f' and {len(files) - 1} more files' if len(files) > 1 else ''}"] if files else [])]
    if not parts:
        return ()
    return (f"{' and '.join(parts)} {'is' if len(names) == 1 else 'are'} not read: {what}",)
