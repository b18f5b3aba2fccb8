"""Chooses the size of pictures, and how many of a clip, before any is read: as is usual, or less if that would leave no time to train."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

from ...pipeline import duration, make_plan
from ...stages.facts import Facts
from ..session import Session, open_session
from .decisions import Decisions
from .defaults import COARSE, expected, guessed_times, stages_before, steps_at_one
from .evaluating import Evaluating
from .known import Known
from .ladder import FRAMES, SIZE, STEPS
from .resolve import shortest
from .words import Deadline

SHARES = (1.0, 0.8, 0.65, 0.5, 0.4)  # of the longer side
LEAST_SIDE = 320  # px; smaller pictures show too little
FRAMES_LEFT = (1.0, 0.5, 0.33, 0.2)  # of a clip's frames
LEAST_FRAMES = 60  # fewer lie too far apart
THINNED_FIRST = 0.6  # of the longer side: before pictures get smaller, a clip loses frames, which only what moves needs
EVERY = "frames.every"


class Fitting(NamedTuple):
    """side: px, the longer one. seconds: of the shortest sensible run with it. fits: whether there is time for that."""

    side: int
    seconds: float
    fits: bool


def sizes(longest: int) -> list[int]:
    """Longest sides to choose from, in decreasing order; the first one is that of the capture."""
    return [longest, *(side for share in SHARES[1:] if (side := round(share * longest / 16) * 16) >= LEAST_SIDE)]


def largest_that_fits(seconds: float, candidates: Sequence[int], seconds_of: Callable[[int], float]) -> Fitting:
    """The largest of ``candidates`` whose shortest sensible run takes at most ``seconds``; the smallest one if none does."""
    needed = [(side, seconds_of(side)) for side in candidates]
    return next((Fitting(side, needs, True) for side, needs in needed if needs <= seconds), Fitting(*needed[-1], False))


def frame_counts(frames: int) -> list[int]:
    """Numbers of frames of a clip to choose from, in decreasing order; the first one is what it has."""
    return [frames, *(count for share in FRAMES_LEFT[1:] if (count := round(share * frames)) >= LEAST_FRAMES)]


def most_that_fits(
    seconds: float, counts: Sequence[int], candidates: Sequence[int], seconds_of: Callable[[int, int], float]
) -> tuple[int, Fitting]:
    """The first of ``counts`` with which a size fits that is not below `THINNED_FIRST`, and that size; else the last one. seconds_of: of a
    number of frames and a longest side."""
    for count in counts:
        found = largest_that_fits(seconds, candidates, partial(seconds_of, count))
        if found.fits and found.side >= THINNED_FIRST * candidates[0]:
            break
    return count, found


def sized(session: Session, deadline: Deadline, say: Callable[[str], None]) -> Session:
    """``session``, opened again with fewer frames of a clip and smaller pictures if what is usual leaves no time to train. Says so, and if
    nothing does."""
    decisions, facts = Decisions(session), Facts.of(session.job.capture.facts)
    if decisions.made_earlier(STEPS, SIZE, FRAMES) or decisions.given(SIZE):
        return session
    longest = max(facts.width, facts.height)
    needs = _Needs(session, decisions)
    if needs.seconds(1.0) <= deadline.left or needs.seconds(1.0, needs.cached()) <= deadline.left:
        return session
    thinned = facts.format == "video" and not (decisions.given(FRAMES) or decisions.given(EVERY))
    counts = frame_counts(facts.frames) if thinned else [facts.frames]
    count, found = most_that_fits(
        deadline.left, counts, sizes(longest), lambda count, side: needs.seconds(side / longest, frames=count / facts.frames)
    )
    if count != facts.frames:
        say(f"--time {deadline.words}: at most {count} of {facts.frames} frames are used, since there is no time for all")
        decisions.make({FRAMES: count})
    if found.side != longest:
        say(f"--time {deadline.words}: pictures are scaled to {found.side} px, since there is no time to train on {longest} px")
        decisions.make({SIZE: found.side})
    if (count, found.side) != (facts.frames, longest):
        session = open_session(session.options)
        needs = _Needs(session, decisions)
    if not found.fits and (seconds := needs.seconds(1.0, needs.cached())) > deadline.left:
        say(
            f"--time {deadline.words} is too short for this capture: the shortest sensible run takes about {duration(seconds)}, "
            "and is done all the same"
        )
    return session


class _Needs:
    """What the shortest sensible run of a session needs, by estimates."""

    def __init__(self, session: Session, decisions: Decisions) -> None:
        self.job = session.job
        self.fixed = int(decisions.value(STEPS)) if decisions.given(STEPS) else None
        self.known = Known(self.job.store.root.parent, self.job.device)
        self.evaluation = Evaluating(self.job, self.known).shortest()
        self.before = stages_before(self.job, COARSE)

    def cached(self) -> frozenset[str]:
        """The stages before training whose results are there."""
        return frozenset(row.stage for row in make_plan(self.job, self.before) if row.state == "cached")

    def seconds(self, share: float, cached: frozenset[str] = frozenset(), frames: float = 1.0) -> float:
        """With pictures that are smaller by ``share``, and ``frames`` of them all. cached: stages that need not run."""
        facts = self.job.capture.facts
        scaled = {**facts, "width": max(1, round(share * facts["width"])), "height": max(1, round(share * facts["height"]))}
        if frames != 1.0:
            scaled |= {name: max(1, round(frames * facts[name])) for name in ("frames", "times", "pairs")}
            scaled["splits"] = {name: max(1, round(frames * n)) for name, n in facts["splits"].items() if n}
        before = sum(expected(self.job, self.known, name, scaled) for name in self.before if name not in cached)
        times = guessed_times(self.job, self.known, None if share == frames == 1.0 else scaled)
        return before + shortest(times, steps_at_one(self.job, scaled), self.fixed) + share**2 * self.evaluation
