"""How long `evaluate` takes: by a few views that are judged as soon as there is a model, before that by its estimate."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from ...pipeline import Artifact, Job
from ..reconstruction import EVALUATION
from .defaults import evaluation_units, guessed_evaluation, views_by_default
from .known import Known
from .resolve import PICTURES, evaluation_within

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
