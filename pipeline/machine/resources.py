"""The resources that a stage uses while it runs."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Resources:
    """An estimate made before the stage runs. A caller that runs several stages at a time uses it for scheduling.

    cores: cores kept busy; None means as many as it is given. memory_gb: peak memory in units of 1e9 bytes. gpu: whether it uses the GPU.
    """

    cores: int | None = None
    memory_gb: float = 1.0
    gpu: bool = False
