"""How far a render is from what the capture shows: colours on one background or, if the capture has alpha, on two, and alpha."""

from __future__ import annotations

import torch
from torch import Tensor

from ...rasterizer import Frame
from ..cpu.appearance import two_backgrounds_loss
from ..cuda.opposite import Opposite
from ..model import Model
from ..settings import TrainingSettings
from ..views import floats
from .photometric import photometric_loss, scale_gradient
from .term import Now, Rendered, Term

OTHER_BACKGROUND = 0.3  # share of the loss with the opposite background, if the capture has alpha


class Appearance(Term):
    """`appearance_loss`, scaled as a mean over the whole image: there is nothing outside the window."""

    name = "appearance"

    def inputs(self, model: Model, now: Now) -> tuple[Tensor | None]:
        views = self.run.views
        known = self.run.settings.alpha_weight and views.load_alpha is not None
        return (views.stored(now.frame, now.scale, "alpha", now.window) if known else None,)

    def value(self, rendered: Rendered, inputs: tuple[Tensor | None]) -> Tensor:
        alpha = None if inputs[0] is None else floats(inputs[0])
        return appearance_loss(rendered, self.run.settings, self.run.views.background, alpha)


def appearance_loss(rendered: Rendered, s: TrainingSettings, background: tuple[float, float, float], alpha: Tensor | None) -> Tensor:
    """The photometric loss of a frame in front of ``background`` (RGB in [0, 1]) and, if the capture's ``alpha`` [h, w] is given, that in
    front of the opposite background and the L1 of alpha: a scalar. On a CUDA device the call does not synchronise."""
    frame, target, kept, weight, recording = rendered.frame, rendered.target, rendered.kept, rendered.weight, rendered.recording
    color, share = frame.color, rendered.share
    if color.dtype == torch.float32:
        terms = share * s.l1_weight, share * s.ssim_weight, weight, recording
        red, green, blue = (1 - 2 * level for level in background)
        change, of_alpha = (red, green, blue), share * s.alpha_weight
        opposite = None if alpha is None else Opposite(frame.alpha, alpha, kept, change, OTHER_BACKGROUND, of_alpha)
        if color.device.type == "cuda":
            from ...rasterizer.cuda.runtime import launcher_for
            from ..cuda import photometric

            return photometric.photometric_loss(launcher_for(color.device), color, target, *terms, opposite)
        return photometric_loss(color, target, *terms) if opposite is None else two_backgrounds_loss(color, target, *terms, opposite)
    loss = photometric_loss(color, target, s.l1_weight, s.ssim_weight, weight, recording)
    if alpha is not None:
        wrong = ((frame.alpha if weight is None else scale_gradient(frame.alpha, weight)) - alpha).abs()
        counts = kept if weight is None else weight != 0 if kept is None else kept & (weight != 0)
        seen = on_other_background(frame, target, alpha, torch.tensor(background, dtype=color.dtype), kept)
        other = photometric_loss(*seen, s.l1_weight, s.ssim_weight, weight, recording)
        missed = s.alpha_weight * (wrong if counts is None else wrong * counts).mean()
        loss = (1 - OTHER_BACKGROUND) * loss + OTHER_BACKGROUND * other + missed
    return loss * share


def on_other_background(frame: Frame, target: Tensor, alpha: Tensor, background: Tensor, kept: Tensor | None) -> tuple[Tensor, Tensor]:
    """Render and ``target`` [h, w, 3], of the given ``alpha`` [h, w], in front of the opposite of ``background`` [3]. Where ``kept`` [h, w]
    bool is False, both are the same.

    On one background alone, a hole in front of it looks like a surface of its colour.
    """
    change = (1 - 2 * background).to(target.device)
    color = frame.color + (1 - frame.alpha)[..., None] * change
    target = target + (1 - alpha)[..., None] * change
    return color, target if kept is None else torch.where(kept[..., None], target, color.detach())
