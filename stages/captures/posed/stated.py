"""Files that state their layout: with one of them, poses of other kinds beside it are leftovers of how it was made."""

from __future__ import annotations

from pathlib import Path

STATED = ("transforms.json", "transforms_train.json", "train_meta.json", "dataset.json")


def states_layout(root: Path) -> bool:
    return any((root / name).is_file() for name in STATED)
