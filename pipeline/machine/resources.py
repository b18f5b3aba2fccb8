"""What a stage takes of a machine while it runs."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Resources:
    """As far as it is known before the stage runs; who starts several at a time plans with it.

    cores: that it keeps busy; None: as many as it is given. memory_gb: at its peak, 1e9 bytes. gpu: whether it computes there.
    """

    cores: int | None = None
    memory_gb: float = 1.0
    gpu: bool = False
