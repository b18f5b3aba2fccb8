"""The store of a workspace: results by key, each published completely or not at all."""

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
    """Contains the artifacts ``<stage>/<key>/``, ``tmp/`` for those being written, ``checkpoints/<stage>-<key>/``, ``locks/``, ``pins/``,
    ``quarantine/`` for damaged artifacts and ``trash/`` for those being removed.

    Only the holder of a key's lock builds that key. So when the lock is taken, anything in ``tmp`` for that key was left by a dead run.
    """

    def __init__(self, root: Path) -> None:
        self.root = Path(root)

    def path(self, stage: str, key: str) -> Path:
        return self.root / stage / key

    def checkpoints(self, stage: str, key: str) -> Path:
        """The folder in which a stage keeps its progress for exactly this key. It is not created here."""
        return self.root / "checkpoints" / f"{stage}-{key}"

    def has(self, stage: str, key: str) -> bool:
        """Whether there is anything under this key. Only opening it shows whether it is valid."""
        return self.path(stage, key).is_dir()

    def open(self, stage: str, key: str) -> Artifact:
        """The artifact under a key. It is not removed as long as the returned object exists. Raises ArtifactError if there is none or it
        is damaged (DamagedError)."""
        return Artifact(self.path(stage, key))

    def manifest(self, stage: str, key: str) -> dict[str, Any] | None:
        """The manifest of an artifact, or None if there is no valid one. The artifact is not held and its files are not checked."""
        path = self.path(stage, key)
        try:
            return parse_manifest(path, (path / MANIFEST).read_bytes())
        except (OSError, DamagedError):
            return None

    def problem(self, stage: str, key: str) -> str:
        """Reads all of an artifact and says what is wrong with it, "" if nothing is. Raises ArtifactError if it cannot be read."""
        try:
            self.open(stage, key).verify()
        except DamagedError as error:
            return error.problem
        return ""

    def quarantine(self, stage: str, key: str) -> Path:
        """Moves what is stored under a key to ``quarantine/<stage>-<key>-<UTC time>-<random>`` in one rename and returns the new path. The
        caller must hold the key's lock.

        Nothing is deleted, because somebody may still want to inspect it.
        """
        folder = self.root / "quarantine"
        folder.mkdir(parents=True, exist_ok=True)
        target = folder / f"{stage}-{key}-{time.strftime('%Y%m%dT%H%M%SZ', time.gmtime())}-{uuid.uuid4().hex[:4]}"
        os.rename(self.path(stage, key), target)
        sync_file(folder)
        return target

    def quarantine_damaged(self, stage: str, key: str) -> Path | None:
        """Like `quarantine`, but only if the artifact is damaged and no process is building it. None if it stays where it is."""
        with self.lock_if_free(stage, key) as free:
            return self.quarantine(stage, key) if free and self.has(stage, key) and self.problem(stage, key) else None

    def touch(self, stage: str, key: str) -> None:
        """Records that a result was used now, as its manifest's modification time. Collection uses it to pick the oldest results."""
        with suppress(OSError):  # owned by another user, or read-only: the result merely looks older than it is
            os.utime(self.path(stage, key) / MANIFEST)

    @contextmanager
    def lock(self, stage: str, key: str, waiting: Any = None) -> Iterator[None]:
        """The exclusive right to build a key, across processes. The operating system frees it if its holder dies.

        ``waiting()`` is called once if another process holds the lock. Raises StageError if the file system has no locks.
        """
        with locked(self._lock(stage, key), waiting=waiting):
            yield

    @contextmanager
    def lock_if_free(self, stage: str, key: str) -> Iterator[bool]:
        """Like `lock`, but does not wait: yields False, without the lock, if another process holds it."""
        with locked(self._lock(stage, key), wait=False) as free:
            yield free

    def _lock(self, stage: str, key: str) -> Path:
        return self.root / "locks" / f"{stage}-{key}.lock"

    @contextmanager
    def writing(self, stage: str, key: str) -> Iterator[ArtifactWriter]:
        """A writer in a temporary folder, which is removed at the end unless it was published. The caller must hold the key's lock."""
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
        """Finishes the writer, moves its folder into place in one rename, and drops the key's checkpoints.

        An artifact that is already there (from a forced run, or damaged) is moved aside first and put back if the rename fails.
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
        """Removes the key's checkpoints in one step: no run must continue from half of one. The caller must hold the key's lock."""
        self.drop(self.checkpoints(stage, key), f"{stage}-{key}")

    def drop(self, folder: Path, name: str) -> None:
        """Removes a folder of the store by first moving it to ``tmp/<name>-...``. After a crash, `sweep` removes what is left there."""
        with suppress(OSError):
            os.rmdir(folder)
            return  # the folder was empty
        place = self.root / "tmp" / f"{name}-{uuid.uuid4().hex[:8]}"
        try:
            os.rename(folder, place)
        except OSError:  # there is no such folder, or no ``tmp``
            place = folder
        for _ in range(2):  # a removal that failed may succeed the second time
            shutil.rmtree(place, ignore_errors=True)

    def _sweep_key(self, stage: str, key: str) -> None:
        for folder in (self.root / "tmp").glob(f"{stage}-{key}-*"):
            shutil.rmtree(folder, ignore_errors=True)

    def sweep(self) -> list[str]:
        """Removes what dead runs left in ``tmp`` and returns the names. What a live process is building is locked and stays."""
        removed = []
        for folder in sorted((self.root / "tmp").glob("*-*-*")):
            stage, key, _ = folder.name.rsplit("-", 2)
            with self.lock_if_free(stage, key) as free:
                if free:
                    shutil.rmtree(folder, ignore_errors=True)
                    removed.append(folder.name)
        return removed

    def entries(self) -> list[tuple[str, str]]:
        """(stage, key) of everything in the store, valid or not."""
        if not self.root.is_dir():
            return []
        stages = sorted(folder for folder in self.root.iterdir() if folder.is_dir() and folder.name not in _INTERNAL)
        return [(folder.name, entry.name) for folder in stages for entry in sorted(folder.iterdir()) if entry.is_dir()]

    def latest(self, stage: str, count: int) -> list[str]:
        """Keys of up to ``count`` results of a stage, most recently used first."""
        used = []
        with suppress(FileNotFoundError), os.scandir(self.root / stage) as entries:
            for entry in entries:
                with suppress(OSError):  # the result is being removed, or was never finished
                    used.append((os.stat(Path(entry.path) / MANIFEST).st_mtime_ns, entry.name))
        return [key for _, key in heapq.nlargest(count, used)]

    def take(self, stage: str, key: str, folder: str) -> Path | None:
        """Moves an artifact to another folder of the store in one rename and returns its new path. None if it stays, because a process
        builds or uses it or because it cannot be locked. If it has already gone, there is nothing at the path that is returned."""
        place = self.root / folder / f"{stage}-{key}-{uuid.uuid4().hex[:8]}"
        place.parent.mkdir(parents=True, exist_ok=True)
        try:
            with self.lock_if_free(stage, key) as unlocked, alone(self.path(stage, key) / MANIFEST) as unused:
                if not (unlocked and unused):
                    return None
                os.rename(self.path(stage, key), place)
        except FileNotFoundError:
            return place  # there is nothing to move, so the result is gone, as requested
        except OSError:
            return None  # it cannot be locked, or is owned by another user
        return place

    def verify(self) -> list[tuple[str, str, str]]:
        """Reads and checks everything: (stage, key, problem), with an empty problem if all is well. Changes nothing."""
        return [(stage, key, self.problem(stage, key)) for stage, key in self.entries()]


def _discard(folder: Path) -> None:
    """Removes a folder that zarr's threads may still be writing to, because zarr does not wait for them after the first error."""
    for _ in range(10):
        shutil.rmtree(folder, ignore_errors=True)
        time.sleep(0.02)
        if not folder.exists():
            return
