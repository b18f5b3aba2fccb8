"""A run that keeps to a time: decides the settings of a stage when it is about to begin, and what is left is known."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from ...pipeline import Artifact, Outcome, duration
from ..reconstruction import EVALUATION
from ..session import Session
from .decisions import Decisions
from .defaults import COARSE, FINE, guessed_times, kind, refines, seconds_of_coarse, steps_at_one, views_by_default
from .evaluating import Evaluating, choose_with
from .known import Known
from .ladder import MEASURED, MOVIES, REFINEMENT, REFINING, SHARE, STEPS
from .resolve import PICTURES, Chosen, TrainingTimes, evaluation_within, refinement_within
from .words import Deadline

PUBLISHING = "publishing"  # the report and the metrics, after the last stage
LEFT_TO_PUBLISH = 2.0  # s, on the machine of the estimates
STEPS_TO_MEASURE, MEASURING = 40, 0.05  # measuring takes the time of so many steps, and at most this share if the costs are known anyway


class Timed:
    """Decides for one run. say: called with a line for people."""

    def __init__(self, session: Session, deadline: Deadline, say: Callable[[str], None]) -> None:
        self.session, self.job, self.deadline, self._say = session, session.job, deadline, say
        self.known = Known(session.job.store.root.parent, session.job.device)
        self.decisions, self.evaluating = Decisions(session), Evaluating(session.job, self.known)
        self._artifacts: dict[str, Artifact | None] = {}
        self._expected: dict[str, float] = {}  # seconds of a stage, without the ratio that is learned from it
        self._refinement_step = 0.0  # seconds of a step of `fine`, as the steps of `coarse` make expect

    def finished(self, outcome: Outcome) -> bool:
        """Takes notice of a stage that is done, and decides for the next one. Returns whether anything was decided."""
        self._artifacts[outcome.stage] = outcome.artifact
        self._learn(outcome)
        order, before = list(self.job.graph.stages), self.session.options.choice.resolved
        following = order[order.index(outcome.stage) + 1 :]
        if following:
            decide = {COARSE: self._before_coarse, FINE: self._before_fine, EVALUATION: self._before_evaluate}
            decide.get(following[0], lambda: None)()
        return self.session.options.choice.resolved != before

    def published(self, seconds: float) -> None:
        """Takes notice of how long it took to write the report and the metrics, and keeps in the workspace what was learned."""
        self.known.learn(seconds, LEFT_TO_PUBLISH, PUBLISHING)
        self.known.write()

    def _before_coarse(self) -> None:
        given = self.decisions.given(STEPS)
        if self.decisions.made_earlier(STEPS, SHARE, REFINING) or (given and not refines(self.job)):
            return
        times, at_one, how = guessed_times(self.job, self.known), steps_at_one(self.job), "as known from earlier runs"
        if self._worth_measuring():
            times, at_one, how = self._measured(times)
        fixed = int(self.decisions.value(STEPS)) if given else None
        left = self.deadline.left - left_to_publish(self.known)
        chosen, evaluation = choose_with(self.evaluating, left, times, at_one, fixed)
        one = chosen.rung
        self._expected[COARSE] = chosen.coarse / self.known.ratio(COARSE, kind(self.job))
        refined = {} if times.fine is None else {SHARE: one.share, REFINING: one.refinement}
        self.decisions.make({STEPS: one.steps} | refined)
        self._say(self._told(chosen, evaluation, left, how, times.fine is not None))

    def _told(self, chosen: Chosen, evaluation: float, left: float, how: str, refined: bool) -> str:
        """What was chosen before `coarse` and why, in one line."""
        words = f"{chosen.rung.steps} steps" + (f" and {chosen.rung.refinement} of refinement" if refined else "")
        parts = f"{duration(chosen.coarse)} + {duration(chosen.hulls + chosen.fine)} + {duration(evaluation)} for evaluation"
        line = f"--time {self.deadline.words}: {words}, of the {duration(max(left, 0.0))} that are left: {parts} ({how})"
        if not chosen.fits:
            return line + "; that is too short, and this is the shortest sensible training"
        return line + ("; more steps would bring nothing, so the time is not used up" if chosen.full else "")

    def _measured(self, guessed: TrainingTimes) -> tuple[TrainingTimes, int, str]:
        """Training by steps that are measured now; the steps of `coarse` at an effort of 1; and how that is known, for people."""
        from .steps.measure import measure_trainings
        from .steps.rehearse import rehearse

        job, begin = self.job, self.deadline.spent
        rehearsed = rehearse(job, COARSE, job.settings[COARSE].model_copy(update={"effort": 1.0, "iterations": 0}), self._artifacts)
        at_one = sum(phase.iterations for phase in rehearsed.trainings[-1].phases)
        costs = measure_trainings(rehearsed.trainings, rehearsed.seconds)
        self.known.keep(kind(job), costs)
        last = costs[-1]
        full = max(last.measured)
        few, many = last.measured[full][0][1], last.measured[full][-1][1]
        self._refinement_step = last.step(full, last.growth.limits.get(full, last.growth.start))
        each = self.known.ratio(FINE, kind(job)) * self._refinement_step
        coarse = seconds_of_coarse(costs, self.known.ratio(COARSE, kind(job)))
        how = f"measured in {duration(self.deadline.spent - begin)}: {1000 * few:.0f} to {1000 * many:.0f} ms a step"
        return TrainingTimes(coarse, (lambda steps: each * steps) if refines(job) else None, guessed.hulls), at_one, how

    def _before_fine(self) -> None:
        from .steps.measure import measure_steps
        from .steps.rehearse import rehearse

        job, coarse = self.job, self._artifacts.get(COARSE)
        if coarse is None or not self.decisions.mine(STEPS, REFINING):
            return
        self.evaluating.judge(self._artifacts, coarse)
        if not self.decisions.mine(REFINING) or not job.graph[FINE].applies(job.capture.facts, job.settings[FINE]).needed:
            return
        rehearsed = rehearse(job, FINE, job.settings[FINE], self._artifacts)
        if not rehearsed.trainings:
            return
        costs, planned = measure_steps(rehearsed.trainings[-1], rehearsed.seconds), int(self.decisions.value(REFINING))
        left = self.deadline.left - left_to_publish(self.known) - self.evaluating.by_default(self._steps())
        steps = refinement_within(left, costs.seconds, max(planned, min(REFINEMENT, 2 * planned)))
        if steps != planned:
            self.decisions.make({REFINING: steps})
            self._say(f"--time {self.deadline.words}: {steps} steps of refinement instead of {planned}, by what is left")

    def _before_evaluate(self) -> None:
        model = self._artifacts.get(FINE) or self._artifacts.get(COARSE)
        if model is None or not self.decisions.mine(STEPS, REFINING):
            return
        self.evaluating.judge(self._artifacts, model)
        views, seconds = views_by_default(self._steps()), self.evaluating.seconds
        found = evaluation_within(self.deadline.left - left_to_publish(self.known), seconds, views)
        expected = seconds(found.measured or views, PICTURES[0] if found.movies is None else found.movies)
        self._expected[EVALUATION] = expected / self.known.ratio(*self.evaluating.place)
        decided: dict[str, Any] = {MEASURED: found.measured, MOVIES: found.movies}
        decided = {name: value for name, value in decided.items() if value is not None}
        if decided:
            self.decisions.make(decided)
            shown = f" and movies have {found.movies} pictures" if found.movies is not None else ""
            self._say(f"--time {self.deadline.words}: {found.measured or views} views of a split are measured{shown}, by what is left")

    def _learn(self, outcome: Outcome) -> None:
        """Compares what a stage took with what was expected."""
        self.known.learn_stage(self.job, outcome)
        name = outcome.stage
        if outcome.state != "ran" or outcome.partly:
            return
        if name == FINE:
            self.known.learn(outcome.seconds, self._refinement_step * (self.decisions.value(REFINING) or 0), FINE, kind(self.job))
        elif name in self._expected:
            place = self.evaluating.place if name == EVALUATION else (name, kind(self.job))
            self.known.learn(outcome.seconds, self._expected[name], *place)
        self.known.write()

    def _worth_measuring(self) -> bool:
        """Whether the costs of steps are unknown, or measuring them again takes a small part of what is left."""
        costs = self.known.costs(kind(self.job))
        if costs is None:
            return True
        each = sum(max(seconds for rows in one.measured.values() for _, seconds in rows) for one in costs)
        return STEPS_TO_MEASURE * each + costs[0].setup <= MEASURING * self.deadline.left

    def _steps(self) -> int:
        return int(self.decisions.value(STEPS)) or steps_at_one(self.job)


def left_to_publish(known: Known) -> float:
    """Seconds for the report and the metrics, after the last stage."""
    return LEFT_TO_PUBLISH * known.ratio(PUBLISHING)
