"""What the steps of one training cost on this machine, and from that how long any number of them takes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from pydantic import TypeAdapter

from .growth import Growth

STRIDE = 100  # steps that are counted at once; between two rounds of density control nothing changes
PROBED, LAST_PROBED = 16, 120  # views in a round of density control, and in a removal
LEAST_SHARE = 0.2  # of the cheapest step that was measured: no step is expected to cost less
FORWARD = 0.4  # of a view in a round: one that is only looked at, without gradients


@dataclass(frozen=True)
class StepCosts:
    """Costs of a training in seconds.

    pieces: (share of the steps, image scale) of its phases, in order. measured: for each image scale, the seconds of a step at numbers of
    Gaussians, as (number, seconds). growth: how the number of Gaussians grows. round: seconds of a round of density control, in steps of
    the same scale and number. removals: (views, whether only looked at) of each pass over the views that comes once a training, such as
    the last removal. loads: seconds to load a picture, by scale. pictures: number of training pictures. setup: seconds before training.
    """

    pieces: tuple[tuple[float, float], ...]
    measured: Mapping[float, tuple[tuple[int, float], ...]]
    growth: Growth
    round: float = 20.0
    removals: tuple[tuple[int, bool], ...] = ()
    loads: Mapping[float, float] | None = None
    pictures: int = 0
    setup: float = 0.0

    def step(self, scale: float, count: float) -> float:
        """Seconds of a step on images of ``scale`` with ``count`` Gaussians: on the line through two measurements, or the one there is."""
        rows = sorted(self.measured[scale])
        least = LEAST_SHARE * min(seconds for _, seconds in rows)
        if len(rows) == 1 or rows[0][0] == rows[-1][0]:
            return rows[-1][1]
        (few, cheap), (many, dear) = rows[0], rows[-1]
        slope = max(0.0, (dear - cheap) / (many - few))
        return max(least, cheap + slope * (count - few))

    def seconds(self, steps: int) -> float:
        """Seconds of a training of ``steps`` steps, everything included."""
        total, done, count = self.setup, 0, float(self.growth.start)
        ends, end = [], 0.0
        for share, scale in self.pieces:
            end += share * steps
            ends.append((end, scale))
        every = self.growth.every(steps)
        due = every
        while done < steps:
            scale = next((scale for end, scale in ends if done < end - 0.5), ends[-1][1])
            stride = min(STRIDE, steps - done)
            each = self.step(scale, count)
            total, done = total + stride * each, done + stride
            count = self.growth.without_hidden(count, done - stride, done, steps)
            while due <= done:
                if self.growth.takes_round(due, steps):
                    total += self.round * each
                    count = self.growth.after(due, steps, count, scale)
                due += every
        last = self.step(ends[-1][1], count)
        for views, only_looked in self.removals:
            total += views / PROBED * self.round * last * (FORWARD if only_looked else 1.0)
        return total + self._loading(steps)

    def _loading(self, steps: int) -> float:
        """Seconds for loading pictures, each once at each scale."""
        return sum(min(share * steps, self.pictures) * (self.loads or {}).get(scale, 0.0) for share, scale in self.pieces)

    def as_json(self) -> dict[str, Any]:
        """For a file. Inverse of `of`."""
        return TypeAdapter(StepCosts).dump_python(self, mode="json")

    @classmethod
    def of(cls, content: Mapping[str, Any]) -> StepCosts:
        """From JSON. Raises ValueError for anything else."""
        return TypeAdapter(cls).validate_python(content)


def merged(pieces: Sequence[tuple[float, float]]) -> tuple[tuple[float, float], ...]:
    """``pieces`` with neighbours of the same scale as one."""
    found: list[tuple[float, float]] = []
    for share, scale in pieces:
        if found and found[-1][1] == scale:
            found[-1] = (found[-1][0] + share, scale)
        else:
            found.append((share, scale))
    return tuple(found)
