"""The folder of a batch: its scenes, and a file with the state of each, which any process can read without asking the head."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Literal, get_args

from ...pipeline import SettingsError
from ...pipeline.files import read_json, write_json
from ...pipeline.storage.lock import is_locked, locked
from .listing import Entry, known

State = Literal["waiting", "running", "done", "failed", "lost"]
LOST = "the process that ran it is gone; the same e4dgs batch command continues it"
LOOK = 0.2  # s between two attempts to lock a scene
WRITTEN = 5.0  # s within which a batch that has begun has written its list


@dataclass
class SceneState:
    """The state of a scene. stage: the one that runs or has failed. seconds: spent on its stages so far, in this batch. attempts: tries so
    far, the first one and one for each failed stage that was tried again.

    "lost" is never written: `Ledger.shown` returns it instead of "running" if no process works on the scene.
    """

    state: State = "waiting"
    stage: str = ""
    message: str = ""
    seconds: float = 0.0
    attempts: int = 0
    changed: float = field(default_factory=time.time)


class Ledger:
    """``<workspace>/batches/<name>/``: ``batch.json`` with the scenes, results, and ``states``, ``logs`` and ``locks`` of the scenes."""

    def __init__(self, workspace: Path, name: str) -> None:
        self.workspace, self.name = workspace, name
        self.folder = workspace / "batches" / name

    @classmethod
    def create(cls, workspace: Path, name: str, entries: Sequence[Entry], command: str = "") -> Ledger:
        """The batch ``name``, new or resumed: finished scenes stay done, and scenes no longer listed are forgotten. command: what a person
        types to resume it."""
        ledger = cls(workspace, name)
        content = {"workspace": str(workspace), "command": command, "scenes": [entry.as_json() for entry in entries]}
        before = {entry.name: entry for entry in ledger.entries()} if ledger.exists() else {}
        write_json(ledger.folder / "batch.json", content)
        for entry in entries:
            if before.get(entry.name) != entry or ledger.progress(entry.name).state != "done":
                ledger.write(entry.name, SceneState())
        return ledger

    @contextmanager
    def held(self, entries: Sequence[Entry]) -> Iterator[None]:
        """While the batch runs, no other process can give it another list than ``entries``; with the same list it may join in. Raises
        SettingsError if another process runs another list."""
        with locked(self.folder / "batch.lock", wait=False) as ours:
            if not ours and not self._lists(entries):
                raise SettingsError(
                    f"--name {self.name}: a batch of this name with another list is running in another process; give this one "
                    "another --name"
                )
            yield

    def _lists(self, entries: Sequence[Entry]) -> bool:
        """Whether the batch, which another process has just begun or is running, has this list."""
        end = time.monotonic() + WRITTEN
        while not self.exists() and time.monotonic() < end:
            time.sleep(0.05)
        return self.exists() and self.entries() == list(entries)

    def replaced_by(self, entries: Sequence[Entry]) -> list[str]:
        """Names of the scenes of an earlier batch of this name that has nothing in common with these ``entries``; [] if there is none."""
        before = [entry.name for entry in self.entries()] if self.exists() else []
        return [] if {entry.name for entry in entries} & set(before) else before

    def exists(self) -> bool:
        return (self.folder / "batch.json").is_file()

    def entries(self) -> list[Entry]:
        """The scenes of the batch. Raises SettingsError if there is no such batch."""
        return [Entry.from_json(row) for row in self._rows()]

    def entry(self, scene: str) -> Entry | None:
        """The scene of this name, None if the batch has none. Raises SettingsError if there is no such batch."""
        row = next((row for row in self._rows() if row["name"] == scene), None)  # the others are not made: workers ask for each part
        return None if row is None else Entry.from_json(row)

    def _rows(self) -> list[dict[str, Any]]:
        content = read_json(self.folder / "batch.json")
        if not isinstance(content, dict):
            raise SettingsError(f"{self.folder}: there is no such batch; batches here: {', '.join(batches(self.workspace)) or 'none'}")
        return content["scenes"]

    def command(self) -> str:
        """The command that resumes the batch, "" if it was not recorded."""
        content = read_json(self.folder / "batch.json")
        return str(content.get("command", "")) if isinstance(content, dict) else ""

    def progress(self, scene: str) -> SceneState:
        """The state as last written; see also `shown`. Fields of later versions are left out, and an unknown state becomes "waiting"."""
        content = read_json(self._state(scene))
        if not isinstance(content, dict) or content.get("state") not in get_args(State):
            return SceneState()
        return SceneState(**known(SceneState, content))

    def shown(self, scene: str) -> SceneState:
        """As `progress`, for people: "lost" if the state is "running" but the process that ran it is gone."""
        found = self.progress(scene)
        if found.state == "running" and not is_locked(self._lock(scene)):
            found = self.progress(scene)  # it may have ended between the two checks
            if found.state == "running":
                return replace(found, state="lost", message=LOST)
        return found

    @contextmanager
    def at_work(self, scene: str, stopped: Callable[[], bool]) -> Iterator[bool]:
        """Locks a scene, so that only one process at a time works on it: True once it is ours, False if ``stopped`` came first.

        Stages of a killed head or worker end a little later than it (`orphan.py`); the next process waits for them here.
        """
        while not stopped():
            with locked(self._lock(scene), wait=False) as ours:
                if ours:
                    yield True
                    return
            time.sleep(LOOK)
        yield False

    def write(self, scene: str, progress: SceneState) -> None:
        progress.changed = time.time()
        write_json(self._state(scene), asdict(progress))

    def log(self, scene: str) -> Path:
        return self.folder / "logs" / f"{scene}.log"

    def metrics(self, scene: str) -> dict[str, Any]:
        """metrics.json of a scene; empty if there is none."""
        content = read_json(self.workspace / "scenes" / scene / "metrics.json")
        return content if isinstance(content, dict) else {}

    def _lock(self, scene: str) -> Path:
        return self.folder / "locks" / scene

    def _state(self, scene: str) -> Path:
        return self.folder / "states" / f"{scene}.json"


def batches(workspace: Path) -> list[str]:
    """Names of the batches of a workspace, the newest last."""
    found = list((workspace / "batches").glob("*/batch.json"))
    return [file.parent.name for file in sorted(found, key=lambda file: file.stat().st_mtime)]
