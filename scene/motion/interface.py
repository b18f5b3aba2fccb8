"""What a motion is asked: what primitives carry for it, where they are at a time, how it starts and how it is trained."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, ClassVar, NamedTuple, Protocol, Self

import numpy as np
import torch
from torch import Tensor, nn

from ...rasterizer import Camera, Convexes, Gaussians
from ..primitives import Attribute, ConvexSet, GaussianSet, PrimitiveSet
from ..settings import Strategy, TrainingSettings
from ..views import Views
from .phases import Phase, coarse_phases
from .rates import Rate, exponential
from .recipe import FirstTraining, Recipe
from .start import Start
from .times import Time


class Scene(Protocol):
    """What a motion sees of the model that it moves."""

    gaussians: GaussianSet
    convexes: ConvexSet

    def moving(self, primitives: PrimitiveSet, camera: Camera | None = None) -> Tensor:
        """Indices [m] of the dynamic ones among the model's Gaussians or convexes. With a ``camera``, those that it cannot see may be
        missing if `Motion.worth_culling`."""
        ...

    def links(self, primitives: PrimitiveSet) -> Tensor | None:
        """`Motion.links` of the model's Gaussians or convexes, as of the last search."""
        ...


class Moved(NamedTuple):
    """M Gaussians, and perhaps corners of convexes after them, at one time: points [N, 3]; quats [M, 4]; log_scales [M, 3], added to the
    logarithms of the Gaussians' scales, or None."""

    points: Tensor
    quats: Tensor
    log_scales: Tensor | None


class Refined(NamedTuple):
    """A motion with other parts, the Gaussians that go with it, and the old row of each of them, -1 if it is new."""

    motion: Motion
    gaussians: GaussianSet
    source: Tensor


class Motion(nn.Module):
    """A motion of a model's primitives. Its parameters are trained along with those of the primitives.

    A kind of motion overrides what is different about it; everything else is as for primitives that stay at rest. `kinds.py` lists the
    kinds. Motions that are defined at places derive from `Carrier`.
    """

    kind: ClassVar[str]  # its name in settings and files
    attributes: ClassVar[Mapping[str, Attribute]] = {}  # what primitives carry for it, by name
    recipe: ClassVar[Recipe] = Recipe()

    static: ClassVar[bool] = False  # whether nothing ever moves
    steady: ClassVar[bool] = False  # whether motion is steady by construction, so that `priors` and `regulariser` do not apply
    priors_at_places: ClassVar[bool] = False  # whether `priors` looks at the places that it is given
    worth_culling: ClassVar[bool] = False  # whether leaving out positions outside the image saves time
    replayable: ClassVar[bool] = True  # whether a CUDA graph can show other times: `Time` may be a tensor
    from_rest: ClassVar[bool] = True  # whether the rest state is learned first, without motion
    most_seeds: ClassVar[int | None] = None  # that it starts from; None: as many as there are
    moving_seeds: ClassVar[bool] = True  # whether seeds on moving objects are of use
    played_as: ClassVar[str] = "static"  # in the web player: "lives", "nodes", sampled "paths", or at rest
    splits_in_time: ClassVar[bool] = False  # whether `halves_in_time` can split a Gaussian that should look different at other times

    # -- as arrays ----------------------------------------------------------------------------------------------------------------

    @property
    def config(self) -> dict[str, Any]:
        """What `from_state` needs in addition to the state, as JSON values."""
        return {"kind": self.kind}

    @classmethod
    def from_state(cls, state: dict[str, Tensor], config: dict[str, Any]) -> Self:
        """Inverse of `state_dict` and `config`. Raises KeyError if something is missing."""
        motion = cls()
        motion.load_state_dict(state)
        return motion

    # -- at a time ----------------------------------------------------------------------------------------------------------------

    def primitives_at(self, scene: Scene, t: Time, camera: Camera | None, sh_degree: int) -> tuple[Gaussians, Convexes]:
        """Both kinds of primitives at time ``t`` in [0, 1], ready for `rasterize`, attached to autograd. If a ``camera`` is given, what it
        cannot see may be at rest."""
        return drawn(scene, sh_degree)

    def opacities(self, gaussians: GaussianSet, t: Time) -> Tensor:
        """[N] opacities of ``gaussians`` at ``t``."""
        return gaussians.opacities

    def carried(self, scene: Scene, index: Tensor, t: float) -> Moved:
        """The Gaussians ``index`` at time ``t``, as if all were dynamic."""
        g = scene.gaussians
        return Moved(g.means[index], g.quats[index], None)

    def in_view(self, gaussians: GaussianSet, camera: Camera, t: Time | None, tiles: Tensor | None, fuller: float) -> Tensor | None:
        """[m] int64: those of ``gaussians`` that ``camera`` may show at ``t`` (None: at rest), if that can be told without moving them
        all; else None. ``tiles``, ``fuller``: see `in_view.in_view`. Everything is on the CPU."""
        return None

    # -- parts --------------------------------------------------------------------------------------------------------------------

    def links(self, primitives: PrimitiveSet) -> Tensor | None:
        """[P, k] int32: which parts of the motion carry each of the P `rest_points`; None if it has no parts. This takes a search, so
        callers keep the result for some steps."""
        return None

    def spread_over(self, points: np.ndarray) -> Motion | None:
        """The same motion with its parts spread again over ``points`` [P, 3]; None if it has no such parts."""
        return None

    def with_turning_parts(self, scene: Scene, views: Views, error: Tensor, seed: int, say: Callable[[str], None]) -> Refined | None:
        """Search for parts with much of the ``error`` [N] of the Gaussians that turn too fast for gradients, and make them rigid. None if
        nothing turns. ``say``: called with lines for people to read."""
        return None

    def in_rigid_parts(self, scene: Scene) -> Tensor:
        """[N] bool: the Gaussians that belong to a part which `with_turning_parts` made rigid."""
        return torch.zeros(len(scene.gaussians), dtype=torch.bool, device=scene.gaussians.device)

    def leave_only_rigid_parts(self, scene: Scene, parameters: Mapping[str, Tensor]) -> None:
        """Clear the gradients of all ``parameters`` (by the names of `Model.named_parameters`) that do not belong to a rigid part."""

    def remember(self) -> None:
        """Compute what a CUDA graph reads and must not compute itself, before one is captured."""

    # -- training -----------------------------------------------------------------------------------------------------------------

    @classmethod
    def start(cls, start: Start, views: Views, settings: TrainingSettings) -> tuple[Self, GaussianSet]:
        """The motion before training, and the Gaussians on its seeds. These carry its attributes."""
        start = start.at_the_middle()
        return cls(), start.gaussians().carrying(cls.attributes)

    @classmethod
    def phases(cls, strategy: Strategy, steps: int, full_from: float, small: bool) -> list[Phase]:
        """The phases of the coarse stage. full_from: fraction of the ``steps`` from which on images have their full size. small: whether
        images of half the size show too little."""
        return coarse_phases(strategy, steps, cls.static, 0.0 if small else full_from, cls.from_rest)

    @classmethod
    def first_training(cls, strategy: Strategy, steps: int, small: bool) -> FirstTraining | None:
        """What is trained before the ``steps`` steps of the coarse stage, if anything is."""
        return None

    def priors(self, rest: Tensor, neighbours: Tensor, t: Time, dt: float) -> tuple[Tensor, Tensor]:
        """How far the motion at ``t`` is from rigid, judged by ``rest`` [n, 3] and nearby ``neighbours`` [n, 3], and how much it changes
        over two steps of ``dt``: two scalars of order one."""
        none = torch.zeros((), device=rest.device)
        return none, none

    def regulariser(self) -> Tensor:
        """The term of lambda_3 in Eq. 9, a scalar."""
        return torch.zeros(())

    def rate(self, name: str, settings: TrainingSettings, unit: float, scale: float) -> Rate:
        """The learning rate of its parameter ``name``. unit: the viewing distance, world units. scale: factor on the first rate of what an
        earlier stage has already trained."""
        return exponential(settings.lr_network * scale, settings.lr_network / 10)

    def attribute_rates(self, settings: TrainingSettings, unit: float, scale: float) -> dict[str, Rate]:
        """The learning rates of `attributes`; ``unit`` and ``scale`` as for `rate`."""
        return {}

    def pace(self, parameters: Mapping[str, Tensor]) -> Tensor | None:
        """A factor [m] on all learning rates of m primitives with these ``parameters``; None if it is 1."""
        return None

    def halves_in_time(self, parents: GaussianSet) -> list[GaussianSet]:
        """The earlier and the later halves of ``parents``, if the motion `splits_in_time`."""
        raise NotImplementedError


def drawn(
    scene: Scene,
    sh_degree: int,
    means: Tensor | None = None,
    quats: Tensor | None = None,
    log_scales: Tensor | None = None,
    points: Tensor | None = None,
    light: Tensor | None = None,
) -> tuple[Gaussians, Convexes]:
    """Both kinds, ready for `rasterize`: at rest, but for what is given. light: see `PrimitiveSet.activated`."""
    g, c = scene.gaussians, scene.convexes
    (scales,), opacities, sh = g.activated((g.log_scales if log_scales is None else log_scales,), sh_degree, light)
    (tau, kappa), convex_opacities, convex_sh = c.activated((c.log_tau, c.log_kappa), sh_degree, light)
    gaussians = Gaussians(g.means if means is None else means, g.quats if quats is None else quats, scales, opacities, sh=sh)
    return gaussians, Convexes(c.points if points is None else points, tau, kappa, convex_opacities, sh=convex_sh)
