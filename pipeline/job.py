"""One run of a workflow on one capture: everything that its keys depend on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

from .graph import Graph
from .keys import capture_files, digest_of_files, key_parts
from .records import Records
from .settings import Settings
from .stage import Capture, Stage
from .storage.store import Store


@dataclass
class Job:
    """``settings`` holds an instance for every stage of the graph; ``device`` is "cpu" or "cuda".

    also: stores that are only read, whose results are taken over into ``store`` instead of computed.
    """

    graph: Graph
    capture: Capture
    settings: Mapping[str, Settings]
    store: Store
    records: Records
    device: str = "cpu"
    also: Sequence[Store] = ()
    refused: set[Path] = field(default_factory=set)  # results in any store that turned out to be damaged, and are not asked for again

    @cached_property
    def capture_files(self) -> dict[str, str]:
        """Content digests of the capture's files, computed once and only when a stage asks for them. Raises CaptureError."""
        return capture_files(self.capture)

    @cached_property
    def capture_digest(self) -> str:
        """Content digest of the capture. Raises CaptureError."""
        return digest_of_files(self.capture_files)

    def parts(self, stage: Stage, inputs: Mapping[str, str | None]) -> dict[str, Any]:
        """Key parts of a stage, given the content digests of its inputs (None: skipped)."""
        capture = self.capture_digest if stage.reads_capture else None
        return key_parts(stage, self.settings[stage.name], inputs, capture, self.device)
