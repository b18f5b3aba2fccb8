"""Density control: when primitives are added and removed, and how many."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import torch
from torch import Tensor

from ...motion.phases import Phase
from ...motion.recipe import Recipe
from ...settings import TrainingSettings
from ...views import Views
from ..curriculum import Curriculum
from .density import Measure, Responsibility, measure_responsibility, survivors
from .dynamics import on_moving_pixels
from .hidden import seen_share
from .learned_model import LearnedModel
from .splits import choose_to_split, split

FIRST_ROUND = 200  # no round before this step
DENSIFY_EVERY = 100
PROBE_VIEWS, FINAL_VIEWS = 16, 120  # views whose error decides where to grow; views whose blending decides what to remove at the end
MOST_FOR_ONE = 4  # maximum ratio of all Gaussians to the budget, which limits those present at one time
SMALL_SHARE = 0.6  # of the budget, while a rig trains on small images: its cameras together see more than one image shows
GAUSSIANS_PER_PIXEL = 0.6  # of the images in use: small images cannot distinguish more Gaussians
IN_TIME_FROM, IN_TIME = 0.2, 0.1  # from this share of training on, a Gaussian is split in time if more of its error than this changes sign
IN_TIME_UNSEEN = 0.3  # the same for one at rest where no mask shows movement
TIMES_TO_SPLIT = 16  # times of a capture from which on that is done; with fewer, a life has one or two views, which it fits alone


class DensityControl:
    """Adds primitives to ``learned`` where the error is, and removes those that contribute nothing.

    phases: of the whole training. budget: maximum number of Gaussians present at one time. most: of all, by default `MOST_FOR_ONE` times as
    many. grow: whether any are added. event: called with what happened.
    measure: does the work of `measure_responsibility`. moving(i): the moving pixels of frame i, see `on_moving_pixels`; None if nothing
    is known about them.
    """

    def __init__(
        self,
        learned: LearnedModel,
        views: Views,
        curriculum: Curriculum,
        settings: TrainingSettings,
        recipe: Recipe,
        phases: Sequence[Phase],
        budget: int,
        grow: bool,
        event: Callable[[str], None],
        measure: Measure = measure_responsibility,
        moving: Callable[[int], Tensor | None] | None = None,
        most: int | None = None,
    ) -> None:
        self.learned, self.views, self.curriculum, self.settings, self.recipe = learned, views, curriculum, settings, recipe
        self._measure, self._moving = measure, moving
        self.budget, self.grow, self._event = budget, grow, event
        self.most = MOST_FOR_ONE * budget if most is None else most
        self.total = total = sum(phase.iterations for phase in phases)
        self.grow_until = recipe.grow_until if settings.densify_until is None else settings.densify_until
        self.every = settings.densify_every or max(DENSIFY_EVERY, total // recipe.rounds)
        self._last_removal = round(recipe.prune_at * total)
        self._ends_moving = phases[-1].move if phases else False
        self._hidden_at = {round(share * total) for share in recipe.hidden_at} if grow and settings.hidden else set()

    def after_step(self, step: int, phase: Phase, rigid_parts_alone: bool) -> None:
        """Do what is due after ``step`` steps. rigid_parts_alone: only Gaussians that belong to a rigid part may be split."""
        if step in self._hidden_at:
            self._remove_hidden(step, phase)
        if step == self._last_removal < self.total:
            self._remove_hardly_seen(step)
        if step % self.every == 0 and step >= FIRST_ROUND and step / max(self.total, 1) <= self.grow_until:
            self.round(step, phase, rigid_parts_alone)

    def finish(self, step: int) -> None:
        """The last removal, if training ended before it was due."""
        if step < self._last_removal or self._last_removal >= self.total:
            self._remove_hardly_seen(step)

    def round(self, step: int, phase: Phase, rigid_parts_alone: bool = False) -> None:
        """One round: remove primitives that have faded, and add Gaussians where the error is."""
        self._prune(step)
        if not self.grow:
            return
        model, progress = self.learned.model, step / max(self.total, 1)
        probed = self.curriculum.probe(step, PROBE_VIEWS)
        measured = self._measure(model, self.views, probed, phase.move, phase.scale)
        alive = round(float(measured.life_gaussians.sum()))  # Gaussians absent at a time cost nothing then
        room = min(self._most(phase) - alive, self.most - len(model.gaussians))
        if room <= 0:
            return
        error = measured.error_gaussians
        if not self.curriculum.several:
            # Half way between the mean error in the views of a life and that in all views. By the former, brief lives, whose few views are
            # noisy, took nearly all where a single camera moves, and what is static around them stayed blurred.
            error = error * measured.life_gaussians.sqrt()
        if rigid_parts_alone:
            error = torch.where(model.motion.in_rigid_parts(model), error, 0.0)
        rounds_left = max(1, round((self.grow_until - progress) * self.total / self.every))
        wanted = room // rounds_left if self.recipe.steady else max(room // rounds_left, alive // 8)
        chosen = choose_to_split(model.gaussians, error, min(room, wanted))
        in_time = self._in_time(measured, progress, chosen, probed)
        self.learned.replace(*split(model.gaussians, chosen[~in_time], chosen[in_time], model.motion.halves_in_time), step)

    def _in_time(self, measured: Responsibility, progress: float, chosen: Tensor, probed: list[int]) -> Tensor:
        """[n] bool, those of the Gaussians ``chosen`` [n] that are split in time: they should look different at some times of their lives,
        which no split in space can mend. None in a rig, where views of one time differ as well, so that the measured share says less.

        What is at rest where the masks show no movement needs better evidence. There the error changes its sign because the shape is wrong
        or the view is another one: halves that each fit a part of the path hide it from there, and show it from beside.
        """
        varying = measured.varying_gaussians[chosen]
        changing = varying > IN_TIME
        if progress <= IN_TIME_FROM or self.curriculum.several or len(self.curriculum.times) < TIMES_TO_SPLIT:
            return torch.zeros_like(changing)
        gaussians = self.learned.model.gaussians
        rests = (changing & ~gaussians.dynamic[chosen]).nonzero()[:, 0]
        if self._moving is not None and len(rests):
            moves = on_moving_pixels(gaussians.means.detach()[chosen[rests]], self.views, probed, self._moving)
            changing[rests] = moves | (varying[rests] > IN_TIME_UNSEEN)
        return changing

    def _most(self, phase: Phase) -> int:
        """The maximum number of Gaussians that the images of ``phase`` allow."""
        if phase.scale == 1:
            return self.budget
        width, height = self.views.size(phase.scale)
        of_cameras = round(SMALL_SHARE * self.budget) if self.curriculum.several else 0
        return min(self.budget, max(round(GAUSSIANS_PER_PIXEL * width * height), of_cameras))

    def _prune(self, step: int, weights: tuple[Tensor | None, Tensor | None] = (None, None)) -> None:
        """Remove primitives that are nearly transparent and, if ``weights`` in px a view are given, those that are hardly blended."""
        model = self.learned.model
        for primitives, weight in zip((model.gaussians, model.convexes), weights):
            keep = survivors(primitives, self.settings.min_opacity, weight, self.settings.min_contribution)
            if len(keep) < len(primitives):
                self.learned.replace(primitives.select(keep), keep, step)

    def _remove_hidden(self, step: int, phase: Phase) -> None:
        """Remove Gaussians that no view sees because others are in front of them."""
        gaussians = self.learned.model.gaussians
        probed = self.curriculum.probe(step, FINAL_VIEWS)
        seen = seen_share(self.learned.model, self.views, probed, phase.move, phase.scale)
        keep = (seen >= self.settings.hidden).nonzero()[:, 0]
        self._event(f"step {step}: {len(gaussians) - len(keep)} of {len(gaussians)} Gaussians are hidden behind others and were removed")
        self.learned.replace(gaussians.select(keep), keep, step)

    def _remove_hardly_seen(self, step: int) -> None:
        """Remove primitives that the training views hardly blend."""
        model = self.learned.model
        measured = self._measure(model, self.views, self.curriculum.probe(self.total, FINAL_VIEWS), self._ends_moving, 0.5)
        before = len(model.gaussians), len(model.convexes)
        self._prune(step, (measured.weight_gaussians, measured.weight_convexes))
        self._event(
            f"step {step}: removed because hardly any training view shows them: {before[0] - len(model.gaussians)} Gaussians, "
            f"{before[1] - len(model.convexes)} convexes"
        )
