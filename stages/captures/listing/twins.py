"""Pictures of one name with two suffixes: colour and depth of one frame, or two files of one picture."""

from __future__ import annotations

import posixpath
from pathlib import Path

from ....pipeline import CaptureError
from ....vision.images.files import BadImageError, open_image


def without_depth(root: Path, names: list[str]) -> tuple[list[str], tuple[str, ...], tuple[str, ...]]:
    """(pictures that show colours, those taken for depth, notes about both). Of two pictures `a.jpg` and `a.png`, one of 16 bits of grey is
    the depth of the other. Raises CaptureError if all pictures are there twice otherwise: they would be read as twice as many frames."""
    groups: dict[str, list[str]] = {}
    for name in names:
        groups.setdefault(posixpath.splitext(name)[0].lower(), []).append(name)
    deep: list[str] = []
    for group in groups.values():
        if len(group) > 1:
            grey = [name for name in group if _grey_of_16_bits(root / name)]
            deep += grey if len(grey) < len(group) else []
    apart = set(deep)
    kept = [name for name in names if name not in apart]
    notes = []
    if deep:
        notes.append(
            f"{len(deep)} pictures of 16 bits of grey with the name of another picture (first {deep[0]}) are taken for its depth "
            "and are not read"
        )
    twins = [group for group in groups.values() if sum(name not in apart for name in group) > 1]
    if twins:
        first = " and ".join(name for name in twins[0] if name not in apart)
        if len(twins) == len(groups):
            raise CaptureError(
                f"{root}: every picture is there twice, with two suffixes (first {first}), which would be twice as many frames; keep one "
                "kind in this folder"
            )
        notes.append(f"{len(twins)} pictures are there with two suffixes (first {first}): each is a frame of its own")
    return kept, tuple(deep), tuple(notes)


def _grey_of_16_bits(file: Path) -> bool:
    try:
        with open_image(file) as image:
            return image.mode.startswith("I;16")
    except BadImageError:
        return False  # its header is checked where it is read
