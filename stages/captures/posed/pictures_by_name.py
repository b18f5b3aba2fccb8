"""All pictures of a capture by their names: under other spellings of a path, and by the ends of paths."""

from __future__ import annotations

import itertools
import os
import posixpath
from collections.abc import Callable, Collection
from functools import cached_property
from pathlib import Path

from ....pipeline.names import composed
from .. import checks

MOST_LISTED = 500_000  # pictures of a capture that are looked through for one that is not where it should be


class Pictures:
    """All pictures of a capture by name, listed at the first question."""

    def __init__(self, root: Path) -> None:
        self.paths: dict[str, str] = {}  # by the composed form of the path
        self.stems: dict[str, set[str]] = {}
        self._named: dict[str, list[str]] = {}
        count = 0
        for base, folders, files in os.walk(root):
            folders[:] = sorted(f for f in folders if not f.startswith(".") and not checks.is_foreign(Path(base) / f))
            at = Path(base).relative_to(root).as_posix()
            at = "" if at == "." else f"{at}/"
            for file in sorted(files):
                if file.startswith(".") or not file.lower().endswith(checks.IMAGE_SUFFIXES) or not (Path(base) / file).is_file():
                    continue
                path = at + file
                self.paths.setdefault(composed(path), path)
                self.paths.setdefault(composed(posixpath.splitext(path)[0]), path)
                self.stems.setdefault(at.rstrip("/"), set()).add(stem_of(path))
                self._named.setdefault(stem_of(path), []).append(path)
                count += 1
            if count > MOST_LISTED:
                break

    def in_another_form(self, name: str) -> str | None:
        return self.paths.get(composed(posixpath.normpath(name)))

    def nearest(self, raw: str, taken: Collection[str] = ()) -> str | None:
        """The one picture whose path has more of the end of ``raw`` than all others, at least its name; None if there is none."""
        wanted = composed(raw.replace("\\", "/")).split("/")[-2::-1]
        lengths: dict[int, list[str]] = {}
        for path in self.named(raw):
            if path not in taken:
                same = itertools.takewhile(lambda pair: pair[0] == pair[1], zip(wanted, composed(path).split("/")[-2::-1], strict=False))
                lengths.setdefault(sum(1 for _ in same), []).append(path)
        best = lengths[max(lengths)] if lengths else []
        return best[0] if len(best) == 1 else None

    def named(self, raw: str) -> list[str]:
        """Paths of the pictures with the name at the end of a path, which may lack its suffix."""
        name = composed(posixpath.basename(posixpath.normpath(raw.replace("\\", "/"))))
        suffixed = name.lower().endswith(checks.IMAGE_SUFFIXES)
        places = self._named.get(posixpath.splitext(name)[0] if suffixed else name, [])
        return [path for path in places if not suffixed or composed(posixpath.basename(path)) == name]

    def in_another_case(self, name: str) -> list[str]:
        """Paths that differ from ``name`` in capital letters alone."""
        return self._folded.get(composed(posixpath.normpath(name)).casefold(), [])

    def with_another_suffix(self, name: str) -> list[str]:
        """Paths that differ from ``name`` in their suffix, and perhaps in capital letters."""
        return self._bare.get(_bare(name), [])

    @cached_property
    def _folded(self) -> dict[str, list[str]]:
        return self._by(lambda path: composed(path).casefold())

    @cached_property
    def _bare(self) -> dict[str, list[str]]:
        return self._by(_bare)

    def _by(self, key: Callable[[str], str]) -> dict[str, list[str]]:
        found: dict[str, list[str]] = {}
        for path in (path for paths in self._named.values() for path in paths):
            found.setdefault(key(path), []).append(path)
        return found


def stem_of(path: str) -> str:
    return composed(posixpath.splitext(posixpath.basename(path))[0])


def _bare(path: str) -> str:
    return composed(posixpath.splitext(posixpath.normpath(path))[0]).casefold()
