"""The store of a workspace: results by key, each published whole or not at all."""

from __future__ import annotations

import heapq
import os
import shutil
import time
import uuid
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from ..errors import DamagedError
from ..files import sync_file
from .artifact import MANIFEST, Artifact, parse_manifest
from .hold import alone
from .lock import locked
from .writer import ArtifactWriter

_INTERNAL = ("locks", "tmp", "checkpoints", "quarantine", "pins", "trash")


class Store:
    """``<stage>/<key>/`` artifacts, ``tmp/`` for what is being written, ``checkpoints/<stage>-<key>/``, ``locks/``, ``pins/``, and
    ``quarantine/`` and ``trash/`` for what is damaged and what is being removed.

    Whoever holds the lock of a key is the only one who builds it, so whatever lies in ``tmp`` for that key was left by a dead run.
    """

    def __init__(self, root: Path) -> None:
        self.root = Path(root)

    def path(self, stage: str, key: str) -> Path:
        return self.root / stage / key

    def checkpoints(self, stage: str, key: str) -> Path:
        """Where a stage keeps its progress for exactly this key; not created here."""
        return self.root / "checkpoints" / f"{stage}-{key}"

    def has(self, stage: str, key: str) -> bool:
        """Whether something lies under this key; opening it says whether it is valid."""
        return self.path(stage, key).is_dir()

    def open(self, stage: str, key: str) -> Artifact:
        """The artifact under a key, which nobody removes as long as the object lives. Raises ArtifactError when there is none or it is
        damaged (DamagedError)."""
        return Artifact(self.path(stage, key))

    def manifest(self, stage: str, key: str) -> dict[str, Any] | None:
        """The manifest of an artifact, which is not held and whose files are not looked at; None where there is none that is valid."""
        path = self.path(stage, key)
        try:
            return parse_manifest(path, (path / MANIFEST).read_bytes())
        except (OSError, DamagedError):
            return None

    def problem(self, stage: str, key: str) -> str:
        """What is wrong with an artifact, after reading all of it; "" where all is well. Raises ArtifactError where it cannot be read."""
        try:
            self.open(stage, key).verify()
        except DamagedError as error:
            return error.problem
        return ""

    def quarantine(self, stage: str, key: str) -> Path:
        """Moves what lies under a key to ``quarantine/<stage>-<key>-<UTC time>`` in one rename; returns the new place. Hold the key's lock.

        Nothing is deleted: a person may still want to look at it.
        """
        folder = self.root / "quarantine"
        folder.mkdir(parents=True, exist_ok=True)
        target = folder / f"{stage}-{key}-{time.strftime('%Y%m%dT%H%M%SZ', time.gmtime())}-{uuid.uuid4().hex[:4]}"
        os.rename(self.path(stage, key), target)
        sync_file(folder)
        return target

    def quarantine_damaged(self, stage: str, key: str) -> Path | None:
        """`quarantine`, where the artifact is damaged and no process builds it; None where it stays."""
        with self.lock_if_free(stage, key) as free:
            return self.quarantine(stage, key) if free and self.has(stage, key) and self.problem(stage, key) else None

    def touch(self, stage: str, key: str) -> None:
        """Notes that a result was used now: its manifest's time of change, by which the oldest are chosen when something has to go."""
        with suppress(OSError):  # not ours, or not to be written: it only looks older than it is
            os.utime(self.path(stage, key) / MANIFEST)

    @contextmanager
    def lock(self, stage: str, key: str, waiting: Any = None) -> Iterator[None]:
        """The exclusive right to build a key, across processes; the system frees it when its holder dies.

        ``waiting()`` is called once when another process holds it. Raises StageError where the file system has no locks.
        """
        with locked(self._lock(stage, key), waiting=waiting):
            yield

    @contextmanager
    def lock_if_free(self, stage: str, key: str) -> Iterator[bool]:
        """`lock`, but False at once, and without the right, where another process holds it."""
        with locked(self._lock(stage, key), wait=False) as free:
            yield free

    def _lock(self, stage: str, key: str) -> Path:
        return self.root / "locks" / f"{stage}-{key}.lock"

    @contextmanager
    def writing(self, stage: str, key: str) -> Iterator[ArtifactWriter]:
        """A writer in a temporary folder, removed at the end unless published. Hold the key's lock around it."""
        self._sweep_key(stage, key)
        folder = self.root / "tmp" / f"{stage}-{key}-{uuid.uuid4().hex[:8]}"
        folder.mkdir(parents=True)
        try:
            yield ArtifactWriter(folder)
        except BaseException:
            _discard(folder)
            raise
        shutil.rmtree(folder, ignore_errors=True)

    def publish(self, writer: ArtifactWriter, stage: str, key: str, provenance: Mapping[str, Any]) -> Artifact:
        """Finishes the writer and moves its folder into place in one rename; then drops the key's checkpoints.

        An artifact that was there (a forced or damaged one) is moved aside first and put back if the move fails.
        """
        writer.finish(provenance)
        target = self.path(stage, key)
        target.parent.mkdir(parents=True, exist_ok=True)
        aside = None
        if target.exists():
            aside = self.root / "tmp" / f"{stage}-{key}-{uuid.uuid4().hex[:8]}"
            os.rename(target, aside)
        try:
            os.rename(writer.path, target)
        except BaseException:
            if aside is not None:
                os.rename(aside, target)
            raise
        sync_file(target.parent)
        if aside is not None:
            shutil.rmtree(aside, ignore_errors=True)
        self.drop_checkpoints(stage, key)
        return Artifact(target)

    def drop_checkpoints(self, stage: str, key: str) -> None:
        """Removes what lies there in one step: nobody goes on from half of a checkpoint. Hold the key's lock."""
        self.drop(self.checkpoints(stage, key), f"{stage}-{key}")

    def drop(self, folder: Path, name: str) -> None:
        """Removes a folder of the store by way of ``tmp/<name>-...``, which a crash leaves to `sweep`."""
        with suppress(OSError):
            os.rmdir(folder)
            return  # it was empty
        place = self.root / "tmp" / f"{name}-{uuid.uuid4().hex[:8]}"
        try:
            os.rename(folder, place)
        except OSError:  # there is none, or no ``tmp``
            place = folder
        for _ in range(2):  # what failed once may go the second time
            shutil.rmtree(place, ignore_errors=True)

    def _sweep_key(self, stage: str, key: str) -> None:
        for folder in (self.root / "tmp").glob(f"{stage}-{key}-*"):
            shutil.rmtree(folder, ignore_errors=True)

    def sweep(self) -> list[str]:
        """Removes what dead runs left in ``tmp``; whatever a living process builds is locked and stays. Returns the names removed."""
        removed = []
        for folder in sorted((self.root / "tmp").glob("*-*-*")):
            stage, key, _ = folder.name.rsplit("-", 2)
            with self.lock_if_free(stage, key) as free:
                if free:
                    shutil.rmtree(folder, ignore_errors=True)
                    removed.append(folder.name)
        return removed

    def entries(self) -> list[tuple[str, str]]:
        """(stage, key) of everything that lies in the store, valid or not."""
        if not self.root.is_dir():
            return []
        stages = sorted(folder for folder in self.root.iterdir() if folder.is_dir() and folder.name not in _INTERNAL)
        return [(folder.name, entry.name) for folder in stages for entry in sorted(folder.iterdir()) if entry.is_dir()]

    def latest(self, stage: str, count: int) -> list[str]:
        """Keys of up to ``count`` results of a stage, those used last first."""
        used = []
        with suppress(FileNotFoundError), os.scandir(self.root / stage) as entries:
            for entry in entries:
                with suppress(OSError):  # it is being removed, or was never finished
                    used.append((os.stat(Path(entry.path) / MANIFEST).st_mtime_ns, entry.name))
        return [key for _, key in heapq.nlargest(count, used)]

    def remove(self, stage: str, key: str) -> bool:
        """Removes an artifact at once (a crash leaves all of it or nothing). False when a process builds or uses it."""
        place = self.take(stage, key, "tmp")
        if place is not None:
            shutil.rmtree(place, ignore_errors=True)
        return place is not None

    def take(self, stage: str, key: str, folder: str) -> Path | None:
        """Moves an artifact that no process builds or uses to another folder of the store, in one rename; None where it stays."""
        place = self.root / folder / f"{stage}-{key}-{uuid.uuid4().hex[:8]}"
        place.parent.mkdir(parents=True, exist_ok=True)
        try:
            with self.lock_if_free(stage, key) as unlocked, alone(self.path(stage, key) / MANIFEST) as unused:
                if not (unlocked and unused):
                    return None
                os.rename(self.path(stage, key), place)
        except FileNotFoundError:
            return place  # nothing lies there: it is gone, as was asked for
        except OSError:
            return None  # it cannot be locked, or belongs to somebody else
        return place

    def verify(self) -> list[tuple[str, str, str]]:
        """Digests everything again: (stage, key, problem) with an empty problem where all is well. Nothing is changed."""
        return [(stage, key, self.problem(stage, key)) for stage, key in self.entries()]


def _discard(folder: Path) -> None:
    """Removes a folder into which zarr's threads may still write: after the first error nobody waits for the others."""
    for _ in range(10):
        shutil.rmtree(folder, ignore_errors=True)
        time.sleep(0.02)
        if not folder.exists():
            return
