"""`find_pictures`: the pictures that a capture's files name, also where their names are not quite those on disk."""

from __future__ import annotations

import posixpath
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

from ....pipeline import CaptureError
from .. import checks
from ..listing.names import is_image
from .pictures_by_name import Pictures, stem_of

_LONGEST = 4096
_NO_COLOUR = re.compile(r"(^|/)(masks?|segs?|segmentation|depths?|normals?|covisible|conf(idence)?|flow)/", re.IGNORECASE)


@dataclass(frozen=True)
class Found:
    """paths: the picture of each entry that has one, relative to the capture, by the entry's key. notes: for people. gone: keys of entries
    without a picture."""

    paths: dict[int, str]
    notes: tuple[str, ...] = ()
    gone: tuple[int, ...] = ()


def find_pictures(root: Path, names: Mapping[int, tuple[str, str]], file: str, what: str = "frames", beside: str = "") -> Found:
    """The picture of each of ``names`` (name as in ``file``, words that say where it stands), relative to ``beside``, a prefix.

    A picture is looked for as it is named; under another Unicode form of its name; if the path is absolute, inside the capture and by the
    end of the path; with other capital letters or another suffix; and by its name alone, if only one picture has it, in a folder that
    holds no counterpart of the others (so that no mask or depth map takes the place of a deleted picture). Every kind of repair is counted
    in a note. Entries without a picture are left out and counted. Raises CaptureError if these are more than half, and for paths that leave
    the capture.
    """
    return find_pictures_of_splits(root, file, {file: names}, what, beside)[file]


def find_pictures_of_splits(
    root: Path, train: str, names: Mapping[str, Mapping[int, tuple[str, str]]], what: str = "frames", beside: str = ""
) -> dict[str, Found]:
    """As `find_pictures`, for several files by their names, of which all but ``train`` name pictures that are held out.

    A picture of one file is not taken for another's of the same last name. A file of held-out pictures of which none exists, as some
    programs write before anybody renders them, has no paths and a note."""
    searches = {file: _Search(root, dict(own), beside, file != train) for file, own in names.items()}

    def share() -> None:
        for search in searches.values():
            search.others = {path for other in searches.values() if other is not search for path in other.found.values()}

    for search in searches.values():
        search.as_named()
    share()
    for search in searches.values():
        search.by_ends_of_absolute_paths()
        search.in_another_spelling()
    for search in searches.values():
        share()
        search.by_name_alone()
    return {file: search.result(file, what) for file, search in searches.items()}


@dataclass
class _Search:
    root: Path
    names: dict[int, tuple[str, str]]
    beside: str
    held_out: bool
    others: set[str] = field(default_factory=set)  # pictures that are not to be taken by their last names
    found: dict[int, str] = field(default_factory=dict)
    gone: list[int] = field(default_factory=list)
    far: dict[int, CaptureError] = field(default_factory=dict)  # absolute paths outside the capture
    heads: set[str] = field(default_factory=set)  # what was cut off absolute paths whose ends lie in the capture
    other_form: list[int] = field(default_factory=list)
    ends: list[int] = field(default_factory=list)
    spelled: list[int] = field(default_factory=list)
    moved: list[int] = field(default_factory=list)

    def as_named(self) -> None:
        for i, (raw, where) in self.names.items():
            name = raw.replace("\\", "/")
            absolute = is_absolute(name)
            try:
                relative = checks.relative(self.root, name, where) if absolute else self.beside + name
            except CaptureError as error:
                self.far[i] = error
                continue
            path = checks.seek_image(self.root, relative, where)
            if path is None and not name.isascii():
                path = self.folder.in_another_form(relative)
                self.other_form += [i] if path else []
            if path is None:
                self.gone.append(i)
            else:
                self.found[i] = path
                if absolute:
                    self.heads.add(name[: len(name) - len(posixpath.normpath(relative))].rstrip("/"))

    def by_ends_of_absolute_paths(self) -> None:
        for i in list(self.far):
            raw, where = self.names[i]
            parts = posixpath.normpath(raw.replace("\\", "/")).split("/")
            for cut in range(1, len(parts) if len(raw) <= _LONGEST else 1):
                end = "/".join(parts[cut:])
                path = checks.seek_image(self.root, end, where) if not is_absolute(end) else None
                path = path or (self.folder.in_another_form(end) if not end.isascii() else None)
                if path is not None and not ("/" not in end and path in self.others):
                    self.found[i] = path
                    self.ends.append(i)
                    self.heads.add("/".join(parts[:cut]))
                    del self.far[i]
                    break
        for i, error in list(self.far.items()):
            name = posixpath.normpath(self.names[i][0].replace("\\", "/"))
            # It may be of the same place as the others and deleted since, or lie in another folder here.
            left_out = self.held_out and is_absolute(name)
            if (
                not left_out
                and not any(name.startswith(head + "/") for head in self.heads)
                and self.folder.nearest(self.names[i][0]) is None
            ):
                raise CaptureError(f"{error}; no picture of the capture, or more than one, has the end of this path") from error
            self.gone.append(i)

    def in_another_spelling(self) -> None:
        """`a.JPG` for `a.jpg`, since not all systems tell them apart; and `a.png` if all pictures of a folder were converted: where some
        are still there as they are named, a file with another suffix may be a mask or a depth map."""
        if not self.gone:
            return
        as_named = {_kind_of_name(self.beside + self.names[i][0]) for i in self.found}
        taken = set(self.found.values())
        chosen = {}
        for i in self.gone:
            name = self.beside + self.names[i][0].replace("\\", "/")
            places = self.folder.in_another_case(name)
            if not places and is_image(name) and _kind_of_name(name) not in as_named:
                places = self.folder.with_another_suffix(name)
            if len(places) == 1 and places[0] not in taken:
                chosen[i] = places[0]
        self.spelled = self._take(chosen)

    def by_name_alone(self) -> None:
        if not self.gone:
            return
        stems = {stem_of(path) for path in self.found.values()}
        taken = {*self.found.values(), *self.others}
        chosen = {}
        for i in self.gone:
            place = self.folder.nearest(self.names[i][0], taken)
            if place is None or _NO_COLOUR.search(place):
                continue
            if stems.isdisjoint(self.folder.stems[posixpath.dirname(place)] - {stem_of(place)}):
                chosen[i] = place
        self.moved = self._take(chosen)

    def _take(self, chosen: Mapping[int, str]) -> list[int]:
        """Finds the pictures that are chosen once."""
        counts = Counter(chosen.values())
        taken = [i for i, path in chosen.items() if counts[path] == 1]
        self.found |= {i: chosen[i] for i in taken}
        self.gone = sorted(set(self.gone) - set(taken))
        return taken

    def result(self, file: str, what: str) -> Found:
        total, notes = len(self.names), []
        if self.gone:
            raw, where = self.names[self.gone[0]]
            if self.held_out and len(self.gone) == total:
                missing = f"none of the {total} pictures that {file} names is there (first {raw[:200]!r})"
                return Found({}, (f"{missing}, so this file is not used; add its pictures to hold them out",), tuple(self.gone))
            first = f"{where}: no image {(self.beside + raw if not is_absolute(raw) else raw)[:200]!r}"
            places = self.folder.named(raw)[:3]
            if places:
                first += f", but {' and '.join(places)} {'have' if len(places) > 1 else 'has'} its name"
            if 2 * len(self.gone) > total:
                others = f", and so for {len(self.gone)} of {total} {what}"
                raise CaptureError(f"{first} in {self.root}{others}; add the files, correct the paths or remove the {what}")
            notes.append(f"{len(self.gone)} of {total} {what} of {file} have no image and are left out; first {first}")
        for repaired, words in (
            (self.other_form, "are written with other Unicode characters than the files (é as one or as two) and are read all the same"),
            (self.ends, "have absolute paths of another place, and are read by the ends of their paths"),
            (self.spelled, "have other capital letters or another suffix than the files, and are read all the same"),
            (self.moved, "name pictures that are not there, and are read from where the one picture of their name lies"),
        ):
            if repaired:
                first = f"first {self.names[repaired[0]][0][:200]!r}, read from {self.found[repaired[0]]}"
                notes.append(f"{len(repaired)} of {total} {what} of {file} {words}; {first}")
        order = {i: self.found[i] for i in self.names if i in self.found}
        return Found(order, tuple(notes), tuple(self.gone))

    @cached_property
    def folder(self) -> Pictures:
        return Pictures(self.root)


def left_out(names: Sequence[str], total: int, words: str) -> str:
    """A note about entries that are left out, with the first one."""
    return f"{len(names)} of {total} {words}; first {names[0]}"


def _kind_of_name(name: str) -> tuple[str, str]:
    """Folder and suffix."""
    folder, file = posixpath.split(name.replace("\\", "/"))
    return folder, posixpath.splitext(file)[1].lower()


def is_absolute(name: str) -> bool:
    """Also by the rules of Windows. name: with `/` between folders."""
    return name.startswith("/") or re.match(r"^[A-Za-z]:", name) is not None
