"""What stages do by default and what they would take, before anything has run. Imports nothing heavy."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from ...pipeline import Job
from ...scene.motion.kinds import KINDS, choose
from ...scene.motion.nodes.schedule import first_motion_steps
from ...stages.coarse.defaults import auto_iterations
from ...stages.evaluate.spread import SAMPLE, flicker_cameras, most_measured
from ...stages.facts import Facts
from ..reconstruction import EVALUATION
from .known import Known, kind_of
from .resolve import TrainingTimes
from .steps.costs import StepCosts

COARSE, HULLS, FINE = "coarse", "hulls", "fine"  # stages whose steps a time decides
MOVIE_PIXELS = 480 * 360  # of a picture of a movie, at most
SHOWN = 0.5  # of judging a view: one that is only rendered, scaled and encoded

Facts_ = Mapping[str, Any]


def stages_before(job: Job, name: str) -> list[str]:
    """The stages that ``name`` needs, in order, without itself."""
    return [stage.name for stage in job.graph.needed_for([name])][:-1]


def expected(job: Job, known: Known, name: str, facts: Facts_ | None = None, **changed: Any) -> float:
    """Seconds of a stage with these facts and changed settings, by its estimate and what is known of the machine. 0 if it is skipped."""
    facts, stage = job.capture.facts if facts is None else facts, job.graph[name]
    settings = job.settings[name].model_copy(update=changed)
    if not stage.applies(facts, settings).needed:
        return 0.0
    return known.stage_ratio(name) * (stage.estimate(facts, settings) or 0.0)


def steps_at_one(job: Job, facts: Facts_ | None = None) -> int:
    """Steps of `coarse` at an effort of 1."""
    settings = job.settings[COARSE].model_copy(update={"effort": 1.0})
    return auto_iterations(Facts.of(job.capture.facts if facts is None else facts), settings, job.device)  # type: ignore[arg-type]


def refines(job: Job) -> bool:
    """Whether `fine` has something to do: with control nodes only if convexes or steps are asked for."""
    coarse, hulls, fine = (job.settings[name] for name in (COARSE, HULLS, FINE))
    motion = KINDS[choose(coarse.motion, Facts.of(job.capture.facts))]  # type: ignore[attr-defined]
    if not motion.convexes and not hulls.budget and fine.iterations is None:  # type: ignore[attr-defined]
        return False
    return job.graph[FINE].applies(job.capture.facts, fine).needed


def kind(job: Job) -> str:
    """The kind of the capture, for `Known`."""
    return kind_of(job, job.settings[COARSE].model_dump(mode="json"))


def seconds_of_coarse(costs: Sequence[StepCosts], ratio: float = 1.0) -> Callable[[int], float]:
    """Seconds of `coarse` by the costs of its trainings. If there are two, the first one looks for the first motion of control nodes."""

    def seconds(steps: int) -> float:
        each = [first_motion_steps("two-stage", steps), steps] if len(costs) > 1 else [steps]
        return ratio * sum(one.seconds(count) for one, count in zip(costs, each, strict=True))

    return seconds


def guessed_times(job: Job, known: Known, facts: Facts_ | None = None) -> TrainingTimes:
    """Training as earlier runs of captures of this kind make expect, else as the stages estimate."""

    def estimated(steps: int) -> float:
        return expected(job, known, COARSE, facts, iterations=steps)

    def fine(steps: int) -> float:
        return expected(job, known, FINE, facts, iterations=steps)

    costs = known.costs(kind(job)) if facts is None else None
    coarse = estimated if costs is None else seconds_of_coarse(costs, known.ratio(COARSE, kind(job)))
    return TrainingTimes(coarse, fine if refines(job) else None, expected(job, known, HULLS, facts))


def views_by_default(steps: int) -> int:
    """Views of a split that are measured after ``steps`` steps of `coarse`."""
    return most_measured(None, steps)


def evaluation_units(job: Job, measured: int, movies: int, render: float) -> float:
    """How many views' time `evaluate` takes. measured: most views of a split. movies: pictures of each movie. render: seconds of a
    render, as a share of those of judging a view."""
    facts, settings = Facts.of(job.capture.facts), job.settings[EVALUATION]
    splits: Sequence[str] = settings.splits  # type: ignore[attr-defined]
    shown: int = settings.max_views  # type: ignore[attr-defined]
    counts = [facts.splits.get(split, 0) for split in splits if facts.splits.get(split, 0)] or [2 * SAMPLE]
    judged: float = SAMPLE + sum(min(count, measured) + min(count, measured, shown) for count in counts)
    looked = 30.0 + min(counts[-1], movies)  # to show time at one camera and to count renders per second; and a movie at full size
    small = min(1.0, MOVIE_PIXELS / max(facts.width * facts.height, 1))
    if facts.fixed_cameras and not facts.static:
        judged += SHOWN * min(measured, flicker_cameras(facts.times) * facts.times)
    if facts.pairs and not facts.static:
        looked += 2 * shown  # flow pictures
    return judged + (render + SHOWN * (1 - render)) * looked + (render + SHOWN * (1 - render)) * small * movies


def guessed_evaluation(job: Job, known: Known, measured: int, movies: int) -> float:
    """Seconds of `evaluate`, before a view was judged."""
    facts = Facts.of(job.capture.facts)
    each = 0.4 * facts.width * facts.height / 1e6  # s
    return known.stage_ratio(EVALUATION) * (2.0 + each * evaluation_units(job, measured, movies, 0.4))
