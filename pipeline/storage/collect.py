"""Garbage collection, safe while runs are in progress: nothing that is live, pinned, in use or being built is removed."""

from __future__ import annotations

import calendar
import os
import shutil
import time
from collections.abc import Callable, Container
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from ..files import bytes_in
from .artifact import MANIFEST
from .pins import Pins
from .store import Store

Live = Callable[[], Container[tuple[str, str]]]  # (stage, key) of the results that must stay, at the time of the call


@dataclass(frozen=True)
class Item:
    """A result, or some other leftover (then ``key`` is empty and ``stage`` is its place in the store). used: seconds since 1970."""

    stage: str
    key: str
    size: int
    used: float

    @property
    def name(self) -> str:
        return f"{self.stage}/{self.key}" if self.key else self.stage


@dataclass(frozen=True)
class Collected:
    """What was removed; what would have been removed but is in use or being built; and the bytes of the remaining results."""

    removed: list[Item]
    busy: list[Item]
    left: int


def unused(store: Store, live: Live, keep_bytes: int | None = None, older_than: float | None = None) -> tuple[list[Item], int]:
    """The results that `collect` would remove, and the total bytes of all results."""
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
    """Removes results that are neither ``live`` nor pinned, and the remains of dead runs and of damaged results.

    keep_bytes: removes only as many results as needed to get down to this size, least recently used first. older_than: seconds; keeps
    everything used within that time, and also removes checkpoints that no run has touched for that long.
    ``live`` is called twice, because a run may start using a result between the first call and the removal. Such a result is put back.
    """
    with store.lock("collect", "all"):
        for place in _trash(store):
            _put_back(store, place)  # left by a collection that died; this one decides about it again
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
    """The item of a result, or None if it has disappeared in the meantime."""
    path = store.path(stage, key)
    try:
        manifest = path / MANIFEST
        return Item(stage, key, bytes_in(path), (manifest if manifest.exists() else path).stat().st_mtime)
    except OSError:
        return None


def _in(item: Item, results: Container[tuple[str, str]]) -> bool:
    return (item.stage, item.key) in results


def _trash(store: Store) -> list[Path]:
    return sorted((store.root / "trash").glob("*-*-*"))


def _put_back(store: Store, place: Path) -> None:
    if not place.exists():
        return  # the result had gone before it could be taken
    stage, key, _ = place.name.rsplit("-", 2)
    with store.lock_if_free(stage, key) as free:
        if not free:
            return  # a run is just making it again; the next collection will deal with it
        if store.has(stage, key):
            _remove(store, place)
        else:
            os.rename(place, store.path(stage, key))


def _remove(store: Store, place: Path) -> None:
    """Deletes a result from the trash. It moves to ``tmp`` first, because a result half deleted by a crash would be put back from the
    trash."""
    if not place.exists():
        return  # the result had gone before it could be taken
    gone = store.root / "tmp" / place.name
    gone.parent.mkdir(parents=True, exist_ok=True)
    os.rename(place, gone)
    shutil.rmtree(gone, ignore_errors=True)


def _remains(store: Store, older_than: float | None) -> list[Item]:
    """Removes half-written results, quarantined results, and abandoned checkpoints."""
    before = time.time() - (older_than or 0.0)
    found = [Item(f"tmp/{name}", "", 0, 0.0) for name in store.sweep()]
    for folder in sorted((store.root / "quarantine").glob("*-*-*-*")):
        when = _time_of(folder.name)
        if older_than is None or when < before:
            found.append(Item(f"quarantine/{folder.name}", "", bytes_in(folder), when))
            store.drop(folder, folder.name)
    for folder in sorted((store.root / "checkpoints").glob("*-*")) if older_than is not None else ():
        stage, key = folder.name.rsplit("-", 1)
        with store.lock_if_free(stage, key) as free:
            changed = _newest(folder)
            if free and changed < before:
                found.append(Item(f"checkpoints/{folder.name}", "", bytes_in(folder), changed))
                store.drop_checkpoints(stage, key)
    return found


def _time_of(name: str) -> float:
    """When something went into quarantine, taken from its name. A name without a time counts as old."""
    with suppress(ValueError):
        return calendar.timegm(time.strptime(name.rsplit("-", 2)[1], "%Y%m%dT%H%M%SZ"))
    return 0.0


def _newest(folder: Path) -> float:
    with suppress(OSError):
        return max(path.stat().st_mtime for path in (folder, *folder.rglob("*")))
    return time.time()
