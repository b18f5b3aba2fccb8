"""One run of a workflow on one capture: everything that its keys depend on."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from .graph import Graph
from .keys import capture_digest, key_parts
from .records import Records
from .settings import Settings
from .stage import Capture, Stage
from .store import Store


@dataclass
class Job:
    """``settings`` holds an instance for every stage of the graph; ``device`` is "cpu" or "cuda"."""

    graph: Graph
    capture: Capture
    settings: Mapping[str, Settings]
    store: Store
    records: Records
    device: str = "cpu"

    @cached_property
    def capture_digest(self) -> str:
        """Content digest of the capture, computed once and only when a stage asks for it. Raises CaptureError."""
        return capture_digest(self.capture)

    def parts(self, stage: Stage, inputs: Mapping[str, str | None]) -> dict[str, Any]:
        """Key parts of a stage, given the content digests of its inputs (None: skipped)."""
        capture = self.capture_digest if stage.reads_capture else None
        return key_parts(stage, self.settings[stage.name], inputs, capture, self.device)
