"""What an artifact of any stage says about itself beside its arrays."""

from __future__ import annotations

from typing import Any

from ...pipeline import Artifact


def told(artifact: Artifact) -> dict[str, Any]:
    """Attributes and info in one dict, and under `log` the lines that the stage wrote for people."""
    return {**artifact.attrs, **artifact.info, "log": artifact.provenance["log"]}
