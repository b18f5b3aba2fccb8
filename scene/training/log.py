"""The record of a training run."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass
class TrainingLog:
    """What happened during training, for the artifact and the report. Curves are lists of [step, value, ...] rows."""

    loss: list[list[float]] = field(default_factory=list)
    psnr: list[list[float]] = field(default_factory=list)
    primitives: list[list[int]] = field(default_factory=list)
    events: list[str] = field(default_factory=list)
    skipped: dict[str, int] = field(default_factory=dict)
    iterations: int = 0
    seconds: float = 0.0
    nonfinite_steps: int = 0
    stopped: str = "all steps done"
