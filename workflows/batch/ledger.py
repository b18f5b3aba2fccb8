"""The folder of a batch: its scenes, and the state of each in a file of its own, which anyone can read without asking the head."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal, get_args

from ...pipeline import ArtifactError
from ...pipeline.files import read_json, write_json
from .listing import Entry, known

State = Literal["waiting", "running", "done", "failed"]


@dataclass
class Progress:
    """Where a scene stands. stage: the one that runs, or that failed. seconds: of its stages so far, in this batch. attempts: started."""

    state: State = "waiting"
    stage: str = ""
    message: str = ""
    seconds: float = 0.0
    attempts: int = 0
    changed: float = field(default_factory=time.time)


class Ledger:
    """``<workspace>/batches/<name>/``: ``batch.json`` with the scenes, ``states/<scene>.json``, ``logs/<scene>.log``, results."""

    def __init__(self, workspace: Path, name: str) -> None:
        self.workspace, self.name = workspace, name
        self.folder = workspace / "batches" / name

    @classmethod
    def create(cls, workspace: Path, name: str, entries: Sequence[Entry]) -> Ledger:
        """The batch ``name``, new or gone on with: what is done stays done, scenes that are no longer asked for are forgotten."""
        ledger = cls(workspace, name)
        content = {"workspace": str(workspace), "scenes": [entry.as_json() for entry in entries]}
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

    def progress(self, scene: str) -> Progress:
        """Where a scene stands; what a later version has added is left out, and a state that this one does not know counts as waiting."""
        content = read_json(self._state(scene))
        if not isinstance(content, dict) or content.get("state") not in get_args(State):
            return Progress()
        return Progress(**known(Progress, content))

    def write(self, scene: str, progress: Progress) -> None:
        progress.changed = time.time()
        write_json(self._state(scene), asdict(progress))

    def log(self, scene: str) -> Path:
        return self.folder / "logs" / f"{scene}.log"

    def metrics(self, scene: str) -> dict[str, Any]:
        """metrics.json of a scene, empty where there is none."""
        content = read_json(self.workspace / "scenes" / scene / "metrics.json")
        return content if isinstance(content, dict) else {}

    def _state(self, scene: str) -> Path:
        return self.folder / "states" / f"{scene}.json"


def batches(workspace: Path) -> list[str]:
    """Names of the batches of a workspace, the newest last."""
    found = list((workspace / "batches").glob("*/batch.json"))
    return [file.parent.name for file in sorted(found, key=lambda file: file.stat().st_mtime)]
