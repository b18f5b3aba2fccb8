"""One run of a workflow on one capture, with everything that its keys depend on."""

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
    """``settings`` holds one instance for every stage of the graph. ``device`` is "cpu" or "cuda".

    also: stores that are only read. A result found in one of them is copied into ``store`` instead of being computed.
    """

    graph: Graph
    capture: Capture
    settings: Mapping[str, Settings]
    store: Store
    records: Records
    device: str = "cpu"
    also: Sequence[Store] = ()
    refused: set[Path] = field(default_factory=set)  # results, in any store, that turned out to be damaged and are not tried again

    @cached_property
    def capture_files(self) -> dict[str, str]:
        """Content digests of the capture's files, computed once, when a stage first needs them. Raises CaptureError."""
        return capture_files(self.capture)

    @cached_property
    def capture_digest(self) -> str:
        """Content digest of the capture. Raises CaptureError."""
        return digest_of_files(self.capture_files)

    def parts(self, stage: Stage, inputs: Mapping[str, str | None]) -> dict[str, Any]:
        """Key parts of a stage, given the content digests of its inputs (None for a skipped input)."""
        capture = self.capture_digest if stage.reads_capture else None
        return key_parts(stage, self.settings[stage.name], inputs, capture, self.device)
