"""The schedule and the loss weights that depend on the kind of motion."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from .phases import Phase


@dataclass(frozen=True)
class Recipe:
    """What differs between kinds of motion. Times are fractions of all steps.

    freeze_at: when static Gaussians leave the motion. freeze_pixels: a Gaussian that travels less than this, in px of the nearest
    camera, is static. freeze_share: if less than this share of the dynamic Gaussians is static, none leaves. spread_at: when the parts
    of the motion are spread again over the Gaussians. rigid_parts_at: when to search for turning parts. opacity, rest, inertia,
    interval, spread: defaults of these weights of `TrainingSettings`. grow_until: default of its `densify_until`. steady: growth adds
    an equal number in every round, instead of as many as the images allow. rounds: maximum number of rounds of density control, if they
    went on to the last step. prune_at: when primitives that the training views hardly blend are removed; the steps that follow make up
    for the loss. The initial values are those of the planes.
    """

    freeze_at: float = 0.45
    freeze_pixels: float = 0.3
    freeze_share: float = 0.0
    spread_at: tuple[float, ...] = ()
    opacity: float = 0.15
    rest: float = 0.005
    inertia: float = 0.01
    interval: float = 1e-3
    spread: float = 0.0
    rigid_parts_at: tuple[float, ...] = ()
    grow_until: float = 0.75
    rounds: int = 1_000_000
    steady: bool = False
    opens: bool = True
    hidden_at: tuple[float, ...] = ()
    largest_convex: float = math.inf
    prune_at: float = 1.0


@dataclass(frozen=True)
class FirstTraining:
    """A training of the motion alone, before the training proper. budget: most Gaussians. changes: to the training's settings."""

    name: str
    phases: list[Phase]
    recipe: Recipe
    budget: int
    changes: Mapping[str, Any] = field(default_factory=dict)
