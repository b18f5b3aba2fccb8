"""A deformation field that begins where measured tracks go, instead of at rest."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor

from ..losses.motion_terms import PRIOR_EVERY, motion_priors
from ..motion.interface import Motion, Rest
from ..primitives import HYPER
from ..settings import TrainingSettings
from .optimiser import RowAdam
from .rates import learning_rates

STEPS = 1000
SAMPLES = 2048  # tracks a step


def follow_tracks(
    field: Motion,
    rest: np.ndarray,
    times: np.ndarray,
    positions: np.ndarray,
    alive: np.ndarray,
    unit: float,
    settings: TrainingSettings,
    advance: Callable[[int], None] = lambda n: None,
) -> float:
    """Fits ``field`` to tracks, in place: ``rest`` [N, 3] is at ``positions`` [T, N, 3] at ``times`` [T] where it is ``alive`` [T, N].

    unit: the viewing distance, world units. Distances count by their norm, as tracks jump on to something else now and then. Returns the
    median distance at the end, world units.
    """
    named: dict[str, Tensor] = {f"field.{name}": p for name, p in field.named_parameters()}
    optimiser = RowAdam(named, learning_rates(named, settings, unit, 1.0))
    rows = np.flatnonzero(alive.any(1))
    device = next(field.parameters()).device
    start, goal = torch.from_numpy(rest).float().to(device), torch.from_numpy(positions).float().to(device)
    there = torch.from_numpy(alive).to(device)
    hyper, none = start.new_zeros(len(start), HYPER), start.new_zeros(0, 4)
    link = field.links(start, hyper)

    def carried(index: Tensor, t: float) -> Tensor:
        return field.carry(Rest(start[index], none, hyper[index], None if link is None else link[index]), t).points

    dt = 1.0 / max(len(times) - 1, 1)
    rng = np.random.default_rng(settings.seed)
    for step in range(STEPS):
        row = int(rng.choice(rows))
        t = float(times[row])
        index = there[row].nonzero()[:, 0]
        index = index[torch.from_numpy(rng.permutation(len(index))[:SAMPLES]).to(device)]
        loss = ((carried(index, t) - goal[row, index]).square().sum(1) + (1e-3 * unit) ** 2).sqrt().mean() / unit
        if step % PRIOR_EVERY == 0:
            noise = torch.from_numpy(rng.standard_normal((len(index), 3))).float().to(device)
            priors = motion_priors(field, start[index], noise, t, dt, unit, settings)
            loss = loss + PRIOR_EVERY * (settings.tv * field.regulariser() + priors)
        loss.backward()
        optimiser.step(step / STEPS, frozenset())
        advance(1)
    with torch.no_grad():
        left = [(carried(there[r].nonzero()[:, 0], float(times[r])) - goal[r, there[r]]).norm(dim=1) for r in rows]
    return float(torch.cat(left).median())
