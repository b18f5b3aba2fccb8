"""Changes to the motion during training: its parts are spread again, turning parts become rigid, and static Gaussians leave it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

from ...motion.phases import Phase
from ...motion.recipe import Recipe
from ...settings import TrainingSettings
from ...views import Views
from ..curriculum import Curriculum
from .density import measure_responsibility
from .dynamics import freeze_static_gaussians
from .learned_model import LearnedModel

# New rigid parts settle on small images first, with everything else frozen: scales, steps at each scale, the most as a share of all steps.
SETTLE_SCALES, SETTLE_STEPS, SETTLE_SHARE = (0.125, 0.25, 0.5), 1000, 0.03
SOLID = 0.2  # the motion is spread over Gaussians more opaque than this
SEARCH_VIEWS = 120  # views whose error shows where a part may turn


class MotionControl:
    """Changes the motion of ``learned`` when the recipe says so.

    phases: of the whole training. event: called with what happened. say: called with what is going on.

    rigid_parts_alone: whether new rigid parts are settling while nothing else learns, as of the last `settling`.
    """

    def __init__(
        self,
        learned: LearnedModel,
        views: Views,
        curriculum: Curriculum,
        settings: TrainingSettings,
        recipe: Recipe,
        phases: Sequence[Phase],
        event: Callable[[str], None],
        say: Callable[[str], None],
    ) -> None:
        self.learned, self.views, self.curriculum, self.settings, self.recipe = learned, views, curriculum, settings, recipe
        self.total = sum(phase.iterations for phase in phases)
        self._event, self._say = event, say
        self.rigid_parts_alone = False
        self._spread = 0  # how often the motion has been spread again
        self._searched = 0  # how often turning parts have been searched for
        self._joined: int | None = None  # step at which the last rigid part was added
        self._froze = False

    def settling(self, phase: Phase, step: int) -> Phase:
        """``phase``, with smaller images while new rigid parts settle."""
        each = max(1, min(SETTLE_STEPS, round(SETTLE_SHARE * self.total)))
        turn = (step - self._joined) // each if self._joined is not None else len(SETTLE_SCALES)
        self.rigid_parts_alone = turn < len(SETTLE_SCALES)
        return replace(phase, scale=min(phase.scale, SETTLE_SCALES[turn])) if self.rigid_parts_alone else phase

    def after_step(self, step: int, phase: Phase, skipped: dict[str, int]) -> None:
        """Do what is due after ``step`` steps. The number of Gaussians that left the motion is written to ``skipped``."""
        progress = step / max(self.total, 1)
        self._spread_anew(step, progress)
        if self._searched < len(self.recipe.rigid_parts_at) and progress >= self.recipe.rigid_parts_at[self._searched]:
            self._search_rigid_parts(step, phase)
        if not self._froze and progress >= self.recipe.freeze_at and self.curriculum.complete(step):
            self._froze = True
            model = self.learned.model
            count = freeze_static_gaussians(model, self.views, self.recipe.freeze_pixels, self.recipe.freeze_share)
            skipped["static Gaussians taken out of the field"] = count
            self._event(f"step {step}: {count} of {len(model.gaussians)} Gaussians do not move and left the motion")

    def state(self) -> dict[str, Any]:
        """JSON values for a checkpoint."""
        return {"froze": self._froze, "motion": [self._spread, self._searched, self._joined]}

    def load(self, state: dict[str, Any]) -> None:
        """Inverse of `state`."""
        self._froze = state["froze"]
        self._spread, self._searched, self._joined = state["motion"]

    def _spread_anew(self, step: int, progress: float) -> None:
        """Spread the motion over the opaque Gaussians, if it is due by the recipe."""
        model = self.learned.model
        if self._spread >= len(self.recipe.spread_at) or progress < self.recipe.spread_at[self._spread]:
            return
        self._spread += 1
        solid = model.gaussians.opacities.detach() > SOLID
        renewed = model.motion.spread_over(model.gaussians.means.detach()[solid].cpu().numpy()) if bool(solid.any()) else None
        if renewed is None:
            return
        self.learned.renew(renewed, step)
        self._event(f"step {step}: the motion was spread over the Gaussians again")

    def _search_rigid_parts(self, step: int, phase: Phase) -> None:
        """Search for parts that have much of the error and turn too fast for gradients."""
        self._searched, model = self._searched + 1, self.learned.model
        self._say("looking for parts that turn")
        probed = self.curriculum.probe(step, SEARCH_VIEWS)
        error = measure_responsibility(model, self.views, probed, True, phase.scale).error_gaussians
        found = model.motion.with_turning_parts(model, self.views, error, self.settings.seed, self._event)
        if found is not None:
            self.learned.renew(found.motion, step)
            self.learned.replace(found.gaussians, found.source, step)
            self._joined = step
