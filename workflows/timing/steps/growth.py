"""How the number of Gaussians grows in a training, without training: the rules of density control for numbers alone."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

FIRST_ROUND = 200  # as in `scene.training.control.growth`
EVERY = 100
HIDDEN = 0.17  # of the Gaussians that are removed when those are that are hidden behind others, measured on lego
GROWTH = 8  # a round adds at least an eighth, unless growth is steady


@dataclass(frozen=True)
class Growth:
    """start: number of Gaussians at the first step. limits: the number that images of a scale allow. until: share of the steps after which
    there are no more rounds. rounds: most rounds in a training. steady: each round adds as many as the others. grows: whether any are
    added. spacing: steps between two rounds, if a setting says so. hidden_at: shares of the steps after which hidden ones are removed."""

    start: int
    limits: Mapping[float, int]
    until: float = 0.75
    rounds: int = 1_000_000
    steady: bool = False
    grows: bool = True
    spacing: int = 0
    hidden_at: tuple[float, ...] = ()

    def every(self, steps: int) -> int:
        """Steps between two rounds in a training of ``steps`` steps."""
        return self.spacing or max(EVERY, steps // self.rounds)

    def takes_round(self, step: int, steps: int) -> bool:
        """Whether a round after ``step`` of ``steps`` steps renders views to find out where to grow."""
        return self.grows and step >= FIRST_ROUND and step <= self.until * steps

    def after(self, step: int, steps: int, count: float, scale: float) -> float:
        """The number of Gaussians after a round at ``step``, of ``count`` before it."""
        room = self.limits[scale] - count
        if room <= 0:
            return count
        left = max(1, round((self.until - step / steps) * steps / self.every(steps)))
        wanted = room / left if self.steady else max(room / left, count / GROWTH)
        return count + min(room, wanted)

    def without_hidden(self, count: float, start: int, end: int, steps: int) -> float:
        """The number of Gaussians that is left of ``count`` after the removals from step ``start`` to ``end`` of ``steps`` steps."""
        return count * (1 - HIDDEN) ** sum(start < share * steps <= end for share in self.hidden_at)
