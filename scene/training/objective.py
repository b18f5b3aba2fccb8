"""What one step minimises: the terms of the loss (Eq. 8 and 9, and the priors) for one view."""

from __future__ import annotations

import torch
from torch import Tensor

from ...rasterizer import rasterize
from ..losses.table import TERMS
from ..losses.term import Now, Rendered, Run
from ..model import Model
from ..motion.phases import Phase
from ..views import WHOLLY, floats
from .drawn_tiles import DrawnTiles
from .optimiser import ALL_ROWS, Rows
from .steps.dropout import keeps, thinned
from .steps.evaluation import Evaluation
from .steps.inputs import Fixed, StepInputs, frame_inputs

WHOLE_EVERY = 8  # one step in so many uses the whole image where the others are cropped to the object
MOST_SHOWN = 0.8  # of the Gaussians; if a view may show more, selecting them costs more than it saves
DROPOUT_GROWS = 0.75  # of the training; then losses can be compared, to see whether training still improves
RELINK_EVERY = 100  # steps between two searches for the parts of the motion that carry each primitive


class Objective:
    """The loss of each step of ``run``, in two halves: `inputs` reads frame and step, `evaluate` computes with what it is given alone, so
    that a CUDA graph of it can be replayed with other inputs."""

    def __init__(self, run: Run) -> None:
        self.run = run
        self.terms = [term(run) for term in TERMS]
        self.dropout = run.settings.dropout if run.several else 0.0
        self.drawn = DrawnTiles(run.views, run.settings.seed, run.earlier + run.total)

    def __call__(self, model: Model, i: int, step: int, phase: Phase, sh_degree: int) -> Evaluation:
        """Render ``model`` as training frame ``i`` with spherical harmonics up to ``sh_degree`` and evaluate it. ``step`` counts from 0."""
        return self.evaluate(model, self.inputs(model, i, step, phase, sh_degree))

    def inputs(self, model: Model, i: int, step: int, phase: Phase, sh_degree: int) -> StepInputs:
        """What `evaluate` needs to know of the step. Has ``model`` search again for the parts of the motion that carry each primitive if it
        is time: replays find them in the place of the old ones."""
        run, views = self.run, self.run.views
        if step % RELINK_EVERY == 0:
            model.relink()
        window = None if step % WHOLE_EVERY == 0 else views.window(i, phase.scale)
        now = Now(i, step, phase.scale, phase.move, window)
        due = [term for term in self.terms if step % term.every == 0 and term.due(model, now)]
        terms = ((term.name, term.inputs(model, now)) for term in due)
        share = self.left_out(step)
        return StepInputs(
            Fixed(phase.move, sh_degree, views.size(phase.scale), any(term.whole_image for term in due)),
            frame_inputs(views, run.camera(i, phase.scale, window), model.affine, i, phase.scale, window),
            self.drawn.of(i, phase.scale, step) if window is None else None,
            (share, run.earlier + step) if share else None,
            tuple((name, given) for name, given in terms if given is not None),
        )

    def evaluate(self, model: Model, inputs: StepInputs) -> Evaluation:
        """Render ``model`` and sum up the terms that are due."""
        fixed, frame, given = inputs.fixed, inputs.frame, dict(inputs.terms)
        terms = [term for term in self.terms if term.name in given]
        t, camera = frame.time, frame.camera
        tiles = None if inputs.drawn is None else inputs.drawn.tiles
        shown, keep = self._shown(model, inputs, tiles)
        rows, faded = ALL_ROWS, None
        if shown is not None:
            faded = model.opacities_at(t, fixed.move)  # the penalty on opacity holds for all, in view or not
            model = model.with_gaussians(model.gaussians.select(shown))
            rows = Rows.of(model.gaussians, shown)
        gaussians, convexes = model.at(t, camera, fixed.move, fixed.sh_degree)
        opacities = gaussians.opacities if faded is None else faded
        if inputs.left_out is not None:
            gaussians = thinned(gaussians, model.gaussians.dynamic, inputs.left_out[0], keep)
        shapes = gaussians, convexes
        for term in terms:
            shapes = term.shapes(camera, *shapes)
        image = rasterize(camera, *shapes, frame.background, antialiased=model.antialiased, tiles=tiles)
        recording = frame.recording(model.affine)
        target, kept = floats(frame.picture), None if frame.kept is None else floats(frame.kept) >= WHOLLY
        weight = None if inputs.drawn is None else inputs.drawn.pixels(target)
        if kept is not None:  # what the image shows where it does not count must not reach the pixels beside
            target = torch.where(kept[..., None], target, image.color.detach())
            weight = kept.float() if weight is None else kept * weight
        # Terms are scaled as means over the whole image: there is nothing outside the window.
        share = target.shape[0] * target.shape[1] / (fixed.size[0] * fixed.size[1])
        rendered = Rendered(model, t, gaussians, convexes, opacities, image, target, kept, weight, recording, fixed.size, share)
        values = [term.value(rendered, given[term.name]) for term in terms]
        loss = values[0]
        for term, value in zip(terms[1:], values[1:]):
            loss = loss + (value if term.every == 1 else term.every * value)
        return Evaluation(loss, values[0].detach(), image.color, target, weight, recording, rows)

    def left_out(self, step: int) -> float:
        """Share of the Gaussians at rest that step ``step`` leaves out; 0 unless one time alone shows the scene from several sides."""
        return self.dropout * min(self.run.progress(step) / DROPOUT_GROWS, 1.0)

    def _shown(self, model: Model, inputs: StepInputs, tiles: Tensor | None) -> tuple[Tensor | None, Tensor | None]:
        """[m] int64: the Gaussians that the step computes with; None: all of them. Then [N] bool: those of all that are not left out; None
        if that is told already."""
        share = 0.0 if inputs.left_out is None else inputs.left_out[0]
        fuller = 1.0 if isinstance(share, Tensor) else 1 / (1 - share)
        frame, fixed = inputs.frame, inputs.fixed
        seen = model.in_view(frame.time, frame.camera, None if fixed.whole else tiles, fixed.move, fuller)
        if inputs.left_out is not None:
            keep = keeps(model.gaussians.dynamic, share, self.run.settings.seed, inputs.left_out[1])
            return (None, keep) if seen is None else (seen[keep[seen]], None)
        return (seen if seen is not None and len(seen) <= MOST_SHOWN * len(model.gaussians) else None), None
