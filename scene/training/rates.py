"""Learning rates: the first and the last rate of each kind of parameter."""

from __future__ import annotations

from collections.abc import Iterable

from ..motion.interface import Motion
from ..motion.rates import APPEARANCE_END, Rate, exponential
from ..settings import TrainingSettings


def learning_rates(names: Iterable[str], settings: TrainingSettings, unit: float, scale: float, motion: Motion) -> dict[str, Rate]:
    """A rate for each parameter of ``names`` ("gaussians.means", "motion.planes.space.0", "affine.offset", ...).

    unit: the viewing distance, world units. scale: factor on the first rates of parameters that an earlier stage has already trained.
    """
    s, k = settings, scale
    primitives: dict[str, Rate] = {
        "means": exponential(s.lr_means * unit * k, s.lr_means * unit / 50),
        "points": exponential(s.lr_means * unit, s.lr_means * unit / 50),
        "quats": exponential(4e-3 * k, 4e-3 * APPEARANCE_END),
        "log_scales": exponential(1e-2 * k, 1e-2 * APPEARANCE_END),
        "opacity_logits": exponential(5e-2 * k, 5e-2 * APPEARANCE_END),
        "sh_dc": exponential(1e-2 * k, 1e-2 * APPEARANCE_END),
        "sh_rest": exponential(1e-3 * k, 1e-3 * APPEARANCE_END),
        "log_tau": exponential(5e-3, 1e-3),
        "log_kappa": exponential(1e-2, 1e-3),
        "log_gain": exponential(2e-3 * k, 2e-4),
        "offset": exponential(2e-3 * k, 2e-4),
    }
    primitives |= motion.attribute_rates(settings, unit, scale)

    def rate(name: str) -> Rate:
        owner, own = name.split(".", 1)
        return motion.rate(own, settings, unit, scale) if owner == "motion" else primitives[own]

    return {name: rate(name) for name in names}
