"""How long `evaluate` takes: by a few views that are judged as soon as there is a model, before that by its estimate."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from ...pipeline import Artifact, Job
from ..reconstruction import EVALUATION
from .defaults import evaluation_units, guessed_evaluation, views_by_default
from .known import Known
from .resolve import PICTURES, Chosen, TrainingTimes, choose, evaluation_within

if TYPE_CHECKING:
    from .views import ViewCosts


class Evaluating:
    """Of one run."""

    place = (EVALUATION, "views")  # of the ratio by which finished evaluations differed

    def __init__(self, job: Job, known: Known) -> None:
        self.job, self._known = job, known
        self._costs: ViewCosts | None = None

    def judge(self, artifacts: Mapping[str, Artifact | None], model: Artifact) -> None:
        """Judges a few views with ``model``, so that the time of a view is known."""
        from .views import measure_views

        self._costs = measure_views(self.job, artifacts, model)

    def seconds(self, measured: int, movies: int) -> float:
        """Expected seconds if at most ``measured`` views of a split are measured and each movie has ``movies`` pictures."""
        costs = self._costs
        if costs is None:
            return guessed_evaluation(self.job, self._known, measured, movies)
        units = evaluation_units(self.job, measured, movies, min(1.0, costs.render / max(costs.view, 1e-9)))
        return costs.setup + self._known.ratio(*self.place) * costs.view * units

    def by_default(self, steps: int) -> float:
        """Expected seconds without any decision, after ``steps`` steps of `coarse`."""
        return self.seconds(views_by_default(steps), PICTURES[0])

    def shortest(self) -> float:
        """Expected seconds of the shortest sensible evaluation."""
        return evaluation_within(0.0, self.seconds, views_by_default(0)).seconds


def choose_with(
    evaluating: Evaluating, seconds: float, times: TrainingTimes, steps_at_one: int, fixed_steps: int | None
) -> tuple[Chosen, float]:
    """As `resolve.choose`, for ``seconds`` of training and evaluation together. Also the seconds of that evaluation: the usual one, or the
    shortest if no training fits with the usual one."""
    evaluation = evaluating.by_default(fixed_steps or steps_at_one)
    chosen = choose(seconds - evaluation, times, steps_at_one, fixed_steps)
    if not chosen.fits:  # at the cost of what is measured
        evaluation = evaluating.shortest()
        chosen = choose(seconds - evaluation, times, steps_at_one, fixed_steps)
    return chosen, evaluation
