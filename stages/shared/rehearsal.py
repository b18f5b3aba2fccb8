"""A rehearsal: a stage runs up to its training, which is handed over to whoever wants to measure its steps, and does not begin."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from ...pipeline import Context
from ...scene.model import Model
from ...scene.motion.phases import Phase
from ...scene.settings import TrainingSettings
from ...scene.training.log import TrainingLog
from ...scene.views import Views


@dataclass(frozen=True)
class Training:
    """A training that is ready to begin. options: further arguments of `Trainer`."""

    name: str
    model: Model
    views: Views
    phases: list[Phase]
    settings: TrainingSettings
    options: Mapping[str, Any]


class Enough(Exception):
    """Raised by ``Rehearsal.handed`` when the stage need not go on."""


@dataclass
class Rehearsal(Context):
    """The context of a stage that is rehearsed. handed: is given each training in place of running it, and may raise `Enough`."""

    handed: Callable[[Training], None] = field(kw_only=True)

    def hand_over(self, training: Training) -> TrainingLog:
        """Gives ``training`` away; returns the log of a training without steps."""
        self.handed(training)
        return TrainingLog()
