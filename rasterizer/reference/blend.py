"""Front-to-back blending of sorted layers, for both kinds of primitive."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

MIN_ALPHA = 1 / 255  # a layer with a smaller alpha is skipped at that pixel
MAX_ALPHA = 0.99  # alpha is capped at this value; a capped alpha has no gradient
MIN_TRANSMITTANCE = 0.99e-4  # the layer that would take a pixel's transmittance below this is not blended, nor are any behind it


@dataclass(eq=False)
class Layers:
    """The values of n primitives that are blended, front to back."""

    depths: Tensor  # [n]
    colors: Tensor  # [n, 3]
    extras: Tensor  # [n, E]


@dataclass(eq=False)
class Blended:
    """The blended values of P pixels."""

    color: Tensor  # [P, 3], background included
    alpha: Tensor  # [P]
    depth: Tensor  # [P], alpha-weighted mean of depths, 0 where alpha is 0
    extras: Tensor  # [P, E]
    blended: Tensor  # [n] bool, layers that at least one pixel blends


def effective_alphas(raw: Tensor) -> tuple[Tensor, Tensor]:
    """From raw alphas [P, n], front to back: the alphas [P, n] used in blending (0 where not blended), and where they are, [P, n] bool."""
    capped = torch.where(raw < MAX_ALPHA, raw, MAX_ALPHA)
    with torch.no_grad():
        counted = capped >= MIN_ALPHA
        # Ignoring the stop, transmittance only falls, so the first layer that crosses the threshold and all behind it are below it.
        transmittance = torch.cumprod(1 - torch.where(counted, capped, 0.0), dim=1)
        blended = counted & (transmittance >= MIN_TRANSMITTANCE)
    return torch.where(blended, capped, 0.0), blended


def blend(raw: Tensor, layers: Layers, background: Tensor) -> Blended:
    """Blend layers with raw alphas [P, n] over the background [3], which affects only the colour."""
    alphas, blended = effective_alphas(raw)
    behind = torch.cumprod(1 - alphas, dim=1)  # transmittance after each layer
    before = torch.cat([torch.ones_like(raw[:, :1]) if raw.shape[1] else raw, behind[:, :-1]], dim=1)
    weights = before * alphas
    alpha = weights.sum(1)
    empty = alpha == 0
    return Blended(
        color=weights @ layers.colors + (1 - alpha)[:, None] * background,
        alpha=alpha,
        depth=torch.where(empty, 0.0, (weights @ layers.depths) / torch.where(empty, 1.0, alpha)),
        extras=weights @ layers.extras,
        blended=blended.any(0),
    )
