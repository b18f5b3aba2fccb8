"""Removing results that nobody needs, beside runs that go on: nothing that is live, pinned, in use or being built is taken."""

from __future__ import annotations

import calendar
import os
import shutil
import time
from collections.abc import Callable, Container
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from ..files import sizes
from .artifact import MANIFEST
from .pins import Pins
from .store import Store

Live = Callable[[], Container[tuple[str, str]]]  # (stage, key) of the results that must stay, as of now


@dataclass(frozen=True)
class Item:
    """A result, or something else that was left (then ``key`` is empty and ``stage`` its place in the store). used: seconds since 1970."""

    stage: str
    key: str
    size: int
    used: float

    @property
    def name(self) -> str:
        return f"{self.stage}/{self.key}" if self.key else self.stage


@dataclass(frozen=True)
class Collected:
    """What was removed; what would have been but is in use or being built; bytes of the results that are left."""

    removed: list[Item]
    busy: list[Item]
    left: int


def unused(store: Store, live: Live, keep_bytes: int | None = None, older_than: float | None = None) -> tuple[list[Item], int]:
    """The results that `collect` would remove, and the bytes of all results."""
    items = [item for entry in store.entries() if (item := _item(store, *entry)) is not None]
    needed, pinned = live(), Pins(store).results()
    chosen = sorted((item for item in items if not _in(item, needed) and not _in(item, pinned)), key=lambda item: item.used)
    total = sum(item.size for item in items)
    if older_than is not None:
        chosen = [item for item in chosen if item.used < time.time() - older_than]
    if keep_bytes is not None:
        left, least = total, []
        for item in chosen:
            if left <= keep_bytes:
                break
            left -= item.size
            least.append(item)
        chosen = least
    return chosen, total


def collect(store: Store, live: Live, keep_bytes: int | None = None, older_than: float | None = None) -> Collected:
    """Removes results that are neither ``live`` nor pinned, and what dead runs and damage have left.

    keep_bytes: of results; only as many go as it takes to have no more, those first that were used longest ago. older_than: seconds;
    what was used since stays, and checkpoints of runs that nobody has gone on with for so long go, too.
    ``live`` is asked twice: a run may have taken up a result between the first answer and its removal. Such a result is put back.
    """
    with store.lock("collect", "all"):
        for place in _trash(store):
            _put_back(store, place)  # what a collection that died had taken; it is decided anew
        chosen, total = unused(store, live, keep_bytes, older_than)
        taken: list[tuple[Item, Path]] = []
        busy: list[Item] = []
        for item in chosen:
            if (gone := store.take(item.stage, item.key, "trash")) is not None:
                taken.append((item, gone))
            else:
                busy.append(item)
        needed, pinned = live(), Pins(store).results()
        removed = []
        for item, place in taken:
            if _in(item, needed) or _in(item, pinned):
                _put_back(store, place)
                busy.append(item)
            else:
                _remove(store, place)
                removed.append(item)
        left = total - sum(item.size for item in removed)
        return Collected([*removed, *_remains(store, older_than)], busy, left)


def _item(store: Store, stage: str, key: str) -> Item | None:
    """None where it went away meanwhile."""
    path = store.path(stage, key)
    try:
        manifest = path / MANIFEST
        return Item(stage, key, sum(sizes(path).values()), (manifest if manifest.exists() else path).stat().st_mtime)
    except OSError:
        return None


def _in(item: Item, results: Container[tuple[str, str]]) -> bool:
    return (item.stage, item.key) in results


def _trash(store: Store) -> list[Path]:
    return sorted((store.root / "trash").glob("*-*-*"))


def _put_back(store: Store, place: Path) -> None:
    stage, key, _ = place.name.rsplit("-", 2)
    with store.lock_if_free(stage, key) as free:
        if not free:
            return  # a run makes it again just now; the next collection looks once more
        if store.has(stage, key):
            _remove(store, place)
        else:
            os.rename(place, store.path(stage, key))


def _remove(store: Store, place: Path) -> None:
    """Removes a result from the trash for good; one that a crash leaves half of must not lie there, else it would be put back."""
    gone = store.root / "tmp" / place.name
    gone.parent.mkdir(parents=True, exist_ok=True)
    os.rename(place, gone)
    shutil.rmtree(gone, ignore_errors=True)


def _remains(store: Store, older_than: float | None) -> list[Item]:
    """Removes half-written results, quarantine, and forgotten checkpoints."""
    before = time.time() - (older_than or 0.0)
    found = [Item(f"tmp/{name}", "", 0, 0.0) for name in store.sweep()]
    for folder in sorted((store.root / "quarantine").glob("*-*-*-*")):
        when = _time_of(folder.name)
        if older_than is None or when < before:
            found.append(Item(f"quarantine/{folder.name}", "", _bytes(folder), when))
            store.drop(folder, folder.name)
    for folder in sorted((store.root / "checkpoints").glob("*-*")) if older_than is not None else ():
        stage, key = folder.name.rsplit("-", 1)
        with store.lock_if_free(stage, key) as free:
            changed = _newest(folder)
            if free and changed < before:
                found.append(Item(f"checkpoints/{folder.name}", "", _bytes(folder), changed))
                store.drop_checkpoints(stage, key)
    return found


def _time_of(name: str) -> float:
    """When something went into quarantine, which its name says; a name that does not is old."""
    with suppress(ValueError):
        return calendar.timegm(time.strptime(name.rsplit("-", 2)[1], "%Y%m%dT%H%M%SZ"))
    return 0.0


def _bytes(folder: Path) -> int:
    with suppress(OSError):
        return sum(sizes(folder).values())
    return 0


def _newest(folder: Path) -> float:
    with suppress(OSError):
        return max(path.stat().st_mtime for path in (folder, *folder.rglob("*")))
    return time.time()
