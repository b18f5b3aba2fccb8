"""Learning rates: the first and the last rate of each kind of parameter."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from ..settings import TrainingSettings

Rate = Callable[[float], float]
ATTRIBUTES_END = 0.3  # of the first rate: means and motion have to settle, appearance goes on learning


def exponential(first: float, last: float) -> Rate:
    """A rate that decays exponentially from ``first`` to ``last``, as a function of progress in [0, 1]."""
    return lambda progress: first * (last / first) ** min(max(progress, 0.0), 1.0)


def learning_rates(names: Iterable[str], settings: TrainingSettings, unit: float, scale: float) -> dict[str, Rate]:
    """A rate for each parameter of ``names`` ("gaussians.means", "field.planes.space.0", "affine.offset", ...).

    unit: the viewing distance, world units. scale: factor on the first rates of parameters that an earlier stage has already trained.
    """
    s, k = settings, scale
    primitives: dict[str, Rate] = {
        "means": exponential(s.lr_means * unit * k, s.lr_means * unit / 50),
        "points": exponential(s.lr_means * unit, s.lr_means * unit / 50),
        "quats": exponential(4e-3 * k, 4e-3 * ATTRIBUTES_END),
        "log_scales": exponential(1e-2 * k, 1e-2 * ATTRIBUTES_END),
        "opacity_logits": exponential(5e-2 * k, 5e-2 * ATTRIBUTES_END),
        "sh_dc": exponential(1e-2 * k, 1e-2 * ATTRIBUTES_END),
        "sh_rest": exponential(1e-3 * k, 1e-3 * ATTRIBUTES_END),
        "hyper": exponential(1e-4 * unit * k, 1e-5 * unit),
        "shades": exponential(3e-3 * k, 3e-3 * ATTRIBUTES_END),
        "times": exponential(2e-2 * k, 2e-3),
        "log_spans": exponential(1e-2 * k, 1e-3),
        "velocities": exponential(0.2 * s.lr_means * unit * k, 0.2 * s.lr_means * unit / 50),
        "spins": exponential(1e-3 * k, 1e-4),
        "log_tau": exponential(5e-3, 1e-3),
        "log_kappa": exponential(1e-2, 1e-3),
        "log_gain": exponential(2e-3 * k, 2e-4),
        "offset": exponential(2e-3 * k, 2e-4),
    }
    planes, mlp = exponential(s.lr_field * k, s.lr_field / 10), exponential(s.lr_mlp * k, s.lr_mlp / 10)
    # Nodes end at a fiftieth: each of their parameters moves thousands of primitives, and jitter at the end would blur all of them.
    network = exponential(s.lr_nodes if k == 1 else s.lr_nodes / 50, s.lr_nodes / 50)
    rigid_parts = exponential(1e-2 if k == 1 else 1e-4, 1e-4)
    radii, hyper = exponential(5e-3 * k, 5e-4), exponential(1e-4 * unit * k, 1e-5 * unit)

    def rate(name: str) -> Rate:
        owner, last = name.split(".", 1)
        if owner != "field":
            return primitives[last]
        if last in ("log_radii", "hyper"):
            return radii if last == "log_radii" else hyper
        if last.startswith(("network.", "light.")):
            return network
        if last.startswith("rigid_parts."):
            return rigid_parts if last == "rigid_parts.quats" else exponential(rigid_parts(0) * unit / 4, rigid_parts(1) * unit / 4)
        return planes if last.startswith("planes.") else mlp

    return {name: rate(name) for name in names}
