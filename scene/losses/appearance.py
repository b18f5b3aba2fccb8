"""How far a render is from what the capture shows: colours on one background or, if the capture has alpha, on two, and alpha."""

from __future__ import annotations

import torch
from torch import Tensor

from ...rasterizer import Frame
from ..model import Model
from ..settings import TrainingSettings
from .photometric import Recording, photometric_loss, scale_gradient
from .term import Now, Rendered, Term, floats, stored

OTHER_BACKGROUND = 0.3  # share of the loss with the opposite background, if the capture has alpha


class Appearance(Term):
    """`appearance_loss`, scaled as a mean over the whole image: there is nothing outside the window."""

    name = "appearance"

    def inputs(self, model: Model, now: Now) -> tuple[Tensor | None]:
        views = self.run.views
        known = self.run.settings.alpha and views.load_alpha is not None
        return (stored(views, now.frame, now.scale, "alpha", now.window) if known else None,)

    def value(self, rendered: Rendered, inputs: tuple[Tensor | None]) -> Tensor:
        r, alpha = rendered, None if inputs[0] is None else floats(inputs[0])
        background = self.run.views.background
        return appearance_loss(r.frame, r.target, self.run.settings, background, alpha, r.kept, r.weight, r.recording, r.share)


def appearance_loss(
    frame: Frame,
    target: Tensor,
    settings: TrainingSettings,
    background: tuple[float, float, float],
    alpha: Tensor | None = None,
    kept: Tensor | None = None,
    weight: Tensor | None = None,
    recording: Recording | None = None,
    share: float = 1.0,
) -> Tensor:
    """The photometric loss of ``frame`` and, if the capture's ``alpha`` is given, that in front of the opposite background and the L1 of
    alpha: a scalar, times ``share``. On a CUDA device the call does not synchronise.

    Args:
        frame: a render [h, w] in front of ``background``; its colour and alpha receive gradients.
        target: [h, w, 3] float32, with alpha in front of the same background.
        background: RGB in [0, 1].
        alpha: [h, w] float32.
        kept: [h, w] bool, the pixels whose alpha counts; see `on_other_background`. None: all.
        weight, recording: see `photometric_loss`; ``weight`` acts on alpha in the same way.
    """
    s, color = settings, frame.color
    if color.device.type == "cuda" and color.dtype == torch.float32:
        from ...rasterizer.cuda.runtime import launcher_for
        from ..cuda import photometric

        opposite = None
        if alpha is not None:
            red, green, blue = (1 - 2 * level for level in background)
            opposite = photometric.Opposite(frame.alpha, alpha, kept, (red, green, blue), OTHER_BACKGROUND, share * s.alpha)
        terms = share * s.l1, share * s.ssim, weight, recording, opposite
        return photometric.photometric_loss(launcher_for(color.device), color, target, *terms)
    loss = photometric_loss(color, target, s.l1, s.ssim, weight, recording)
    if alpha is not None:
        wrong = ((frame.alpha if weight is None else scale_gradient(frame.alpha, weight)) - alpha).abs()
        counts = kept if weight is None else weight != 0 if kept is None else kept & (weight != 0)
        other = photometric_loss(
            *on_other_background(frame, target, alpha, torch.tensor(background, dtype=color.dtype), kept), s.l1, s.ssim, weight, recording
        )
        loss = (1 - OTHER_BACKGROUND) * loss + OTHER_BACKGROUND * other + s.alpha * (wrong if counts is None else wrong * counts).mean()
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
