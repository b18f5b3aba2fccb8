"""Attributes, info and log lines of an artifact of any stage."""

from __future__ import annotations

from typing import Any

from ...pipeline import Artifact


def report_attributes(artifact: Artifact) -> dict[str, Any]:
    """Attributes and info in one dict; `log` holds the lines that the stage logged for people."""
    return {**artifact.attrs, **artifact.info, "log": artifact.provenance["log"]}
