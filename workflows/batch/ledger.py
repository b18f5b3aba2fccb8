"""The folder of a batch: its scenes, and the state of each in a file of its own, which anyone can read without asking the head."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Literal, get_args

from ...pipeline import ArtifactError
from ...pipeline.files import read_json, write_json
from ...pipeline.storage.lock import is_locked, locked
from .listing import Entry, known

State = Literal["waiting", "running", "done", "failed", "lost"]
LOST = "who ran it is gone; the same e4dgs batch command goes on with it"
LOOK = 0.2  # s between two tries to work on a scene


@dataclass
class Progress:
    """Where a scene stands. stage: the one that runs, or that failed. seconds: of its stages so far, in this batch. attempts: tries so far,
    the first one and one for each stage that failed and was tried again.

    "lost" is never written: it is what `Ledger.shown` makes of "running" where nobody is at work.
    """

    state: State = "waiting"
    stage: str = ""
    message: str = ""
    seconds: float = 0.0
    attempts: int = 0
    changed: float = field(default_factory=time.time)


class Ledger:
    """``<workspace>/batches/<name>/``: ``batch.json`` with the scenes, results, ``states``, ``logs`` and ``locks`` of the scenes."""

    def __init__(self, workspace: Path, name: str) -> None:
        self.workspace, self.name = workspace, name
        self.folder = workspace / "batches" / name

    @classmethod
    def create(cls, workspace: Path, name: str, entries: Sequence[Entry], command: str = "") -> Ledger:
        """The batch ``name``, new or gone on with: what is done stays done, scenes that are no longer asked for are forgotten. command:
        the words that a person types to go on with it."""
        ledger = cls(workspace, name)
        content = {"workspace": str(workspace), "command": command, "scenes": [entry.as_json() for entry in entries]}
        before = {entry.name: entry for entry in ledger.entries()} if ledger.exists() else {}
        write_json(ledger.folder / "batch.json", content)
        for entry in entries:
            if before.get(entry.name) != entry or ledger.progress(entry.name).state != "done":
                ledger.write(entry.name, Progress())
        return ledger

    def exists(self) -> bool:
        return (self.folder / "batch.json").is_file()

    def entries(self) -> list[Entry]:
        """Raises ArtifactError where there is no such batch."""
        content = read_json(self.folder / "batch.json")
        if not isinstance(content, dict):
            raise ArtifactError(f"{self.folder}: there is no such batch; batches here: {', '.join(batches(self.workspace)) or 'none'}")
        return [Entry.from_json(row) for row in content["scenes"]]

    def command(self) -> str:
        """What goes on with the batch, "" where that was not written down."""
        content = read_json(self.folder / "batch.json")
        return str(content.get("command", "")) if isinstance(content, dict) else ""

    def progress(self, scene: str) -> Progress:
        """As it was written last, see also `shown`. What a later version has added is left out, a state that is not known is "waiting"."""
        content = read_json(self._state(scene))
        if not isinstance(content, dict) or content.get("state") not in get_args(State):
            return Progress()
        return Progress(**known(Progress, content))

    def shown(self, scene: str) -> Progress:
        """As `progress`, for people: "lost" where a stage is said to run and whoever ran it is gone."""
        found = self.progress(scene)
        if found.state == "running" and not is_locked(self._lock(scene)):
            found = self.progress(scene)  # it may have come to its end between the two looks
            if found.state == "running":
                return replace(found, state="lost", message=LOST)
        return found

    @contextmanager
    def at_work(self, scene: str, stopped: Callable[[], bool]) -> Iterator[bool]:
        """Only one process at a time works on a scene: True when it is ours, False where ``stopped`` came first.

        Stages of a head or a worker that was killed end a little later than it (`orphan.py`); who comes after them waits here.
        """
        while not stopped():
            with locked(self._lock(scene), wait=False) as ours:
                if ours:
                    yield True
                    return
            time.sleep(LOOK)
        yield False

    def write(self, scene: str, progress: Progress) -> None:
        progress.changed = time.time()
        write_json(self._state(scene), asdict(progress))

    def log(self, scene: str) -> Path:
        return self.folder / "logs" / f"{scene}.log"

    def metrics(self, scene: str) -> dict[str, Any]:
        """metrics.json of a scene, empty where there is none."""
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
