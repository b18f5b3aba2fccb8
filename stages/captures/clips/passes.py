"""Videos that show masks, depth, normals or the like of another one, and no camera. Names tell them where they add a word to that of the
other one; elsewhere such a word may be the name of a camera (`left`, `right` and `normal`), and the pictures decide."""

from __future__ import annotations

import posixpath
import re
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from ..listing.kinds import colour_only, role_of, subject_of
from ..video.survey import survey
from .seen import are_normals, first_pictures, is_blank, is_coloured

_CAMERAS = ("normal", "alpha")  # words that are the names of cameras, too: of the one with the normal lens, of the first
_SAME_COUNT = 0.01  # of the number of frames


class Passes(NamedTuple):
    """left_out: passes, in order. notes: lines about them, and about cameras that are named like passes."""

    left_out: tuple[str, ...]
    notes: tuple[str, ...]


def passes(root: Path, names: Sequence[str]) -> Passes:
    """Which of ``names``, videos in the folder ``root``, are passes of others."""
    marked = [name for name in names if role_of(name) is not None]
    plain = [name for name in names if name not in marked]
    if not marked or not plain:  # of which other video they show something is not known
        return Passes((), ())
    by_name = [name for name in marked if name not in colour_only(list(names))]
    sides = any("right" in _words(name) for name in plain)  # then "left" is a side, and not the colours of stereo
    notes, left_out = [], []
    coloured: bool | None = None
    for name in marked:
        said = name in by_name
        if said and not (set(_words(name)) & set(_CAMERAS) and (sides or not subject_of(name))):
            left_out.append(name)
            notes.append(_told(name, "by the name"))
            continue
        pictures = first_pictures(root, name)
        if role_of(name) == "normal":
            shown = are_normals(pictures)
        else:
            if coloured is None:
                coloured = any(is_coloured(first_pictures(root, other)) for other in plain)
            shown = bool(coloured) and not is_coloured(pictures)
        photographs = is_coloured(pictures) or role_of(name) == "normal"
        if said and (shown or is_blank(pictures) or not photographs):
            left_out.append(name)
            notes.append(_told(name, "by the name and its pictures" if shown else "by the name"))
        elif not said and shown and not is_blank(pictures) and _counts_alike(root, name, plain):
            left_out.append(name)
            notes.append(_told(name, "by the name, its pictures and their number"))
        else:
            notes.append(
                f"{name} is read as a camera: by the name it may show the {role_of(name)} of another video, but not by its pictures; if it "
                "does, take it out of the folder"
            )
    return Passes(tuple(left_out), tuple(notes))


def _told(name: str, how: str) -> str:
    what = f"it shows the {role_of(name)} of another video and is no camera"
    return f"{name}: left out, since {how} {what}; rename it if it is a camera of its own"


def _counts_alike(root: Path, name: str, others: Sequence[str]) -> bool:
    """Whether a video has as many frames as one of ``others``."""
    count = len(survey(root, name).seconds)
    return any(abs((n := len(survey(root, other).seconds)) - count) <= _SAME_COUNT * max(n, count) for other in others)


def _words(name: str) -> list[str]:
    return re.findall(r"[a-z]+", posixpath.splitext(name.lower())[0])
