"""Control nodes: rigid frames that travel through the scene and carry the primitives near them, as in SC-GS (Huang et al. 2024).

If each time is seen by only one camera, each time from another side, the images do not constrain a field that can bend anywhere. They do
constrain a few hundred nodes whose motion comes from one small network, shared by all places and times.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar, Self

import numpy as np
import torch
from torch import Tensor, nn

from ...cuda.graph import in_capture
from ...cuda.over_time import OverTime
from ...primitives import Attribute, GaussianSet, PrimitiveSet
from ...settings import Strategy, TrainingSettings
from ...views import Views
from ..carrier import Carrier, Places
from ..interface import Moved, Refined, Scene
from ..phases import HALF_RESOLUTION, Phase
from ..rates import APPEARANCE_END, Rate, exponential
from ..recipe import FirstTraining
from ..start import Start
from ..times import Time, together
from .courses import SharedCourses, encode_places
from .light import SHADES, Light
from .nodes import Nodes
from .rigid_parts import RigidParts
from .schedule import BY_NODE_PHASES, NODES, first_motion, node_phases
from .skinning import distances, nearest_nodes, skin
from .spread import farthest_points, spacing
from .strain import strain
from .turning import leave_only, make_turning_parts_rigid

COUNT = 512  # nodes at the start
HYPER = 2  # extra coordinates, in addition to x, y, z, in which parts that touch can be apart
NEAREST = 4  # nodes that carry a position
GRAPH = 6  # neighbours of a node in the rigidity term
OUTPUT = 0.3  # scale of the network's output: motion grows from rest, slowly enough to stay coherent
HYPER_SPREAD = 0.1  # standard deviation of the initial hyper coordinates, relative to the mean spacing of the nodes
RIGID_COURSE = 1 / 3  # of the nodes' weight: a rigid part held steadier than this cannot move away from the turn that the search found


class ControlNodes(Carrier):
    """A motion by linear blend skinning over the nearest nodes, which start at rest. Primitives carry `hyper` [2], their own coordinates
    beside those of the nodes, and `shades`, see `Light`.

    Parameters: the ``network`` (place and time of a node -> a turn about its rest position and a shift), ``log_radii`` [B], the radii of
    the nodes' influence, ``hyper`` [B, 2], and the ``light``.

    Args:
        positions: [B, 3] rest positions, world units.
        centre: [3] and extent, world units: the box used to scale places, fixed for the life of the network.
        reach: world units for one unit of the network's shifts.
        seed: of the network's initial weights.
        rigid_parts: rigid parts that the network does not move.
    """

    kind = "nodes"
    attributes: ClassVar[Mapping[str, Attribute]] = {"hyper": Attribute((HYPER,)), "shades": Attribute((SHADES,))}
    placed_by = ("hyper",)
    recipe = NODES
    most_seeds = 2500  # few seeds that multiply where the error is give better results than many
    moving_seeds = False
    played_as = "nodes"
    positions: Tensor
    centre: Tensor

    def __init__(
        self,
        positions: Tensor,
        centre: Tensor,
        extent: float,
        reach: float,
        seed: int = 0,
        rigid_parts: RigidParts | None = None,
    ) -> None:
        super().__init__()
        positions = torch.as_tensor(positions).float()
        self.register_buffer("positions", positions.clone())
        self.register_buffer("centre", torch.as_tensor(centre).float().to(positions.device))
        self.extent, self.reach = float(extent), float(reach)
        self.network = SharedCourses(seed).to(positions.device)
        self.light = Light(seed).to(positions.device)
        generator = torch.Generator().manual_seed(seed)
        self.log_radii = nn.Parameter(spacing(positions).log())
        # Not zero: with equal coordinates everywhere, their gradient would be zero.
        beside = HYPER_SPREAD * spacing(positions).mean() * torch.randn(len(positions), HYPER, generator=generator).to(positions.device)
        self.hyper = nn.Parameter(beside)
        self.rigid_parts = RigidParts.none(positions.device) if rigid_parts is None else rigid_parts
        self._known: dict[str, Tensor] = {}
        self._poses = OverTime(self._poses_at, lambda: self.network)
        self._restlessness = OverTime(self._restlessness_at, lambda: self.network)

    @property
    def config(self) -> dict[str, Any]:
        return {"kind": self.kind, "extent": self.extent, "reach": self.reach}

    @classmethod
    def from_state(cls, state: dict[str, Tensor], config: dict[str, Any]) -> Self:
        rigid_parts = RigidParts(*(state["rigid_parts." + name] for name in ("home", "radius", "quats", "shifts")))
        nodes = cls(state["positions"], state["centre"], config["extent"], config["reach"], rigid_parts=rigid_parts)
        # Models from before light have no shades, so that any light is right for them.
        own = nodes.state_dict()
        if missing := [name for name in own.keys() - state.keys() if not name.startswith("light.")]:  # a version with a different network
            raise KeyError(sorted(missing)[0])
        nodes.load_state_dict(own | state)
        return nodes

    @classmethod
    def over(cls, points: np.ndarray, seed: int = 0) -> Self:
        """Nodes spread over ``points`` [P, 3]. The box that places are scaled by spans their 1st to 99th percentile."""
        low, high = np.percentile(points, 1, axis=0), np.percentile(points, 99, axis=0)
        inside = points[((points >= low) & (points <= high)).all(1)]
        extent = max(0.5 * float((high - low).max()), 1e-6)
        positions = farthest_points(inside if len(inside) else points, COUNT)
        return cls(torch.tensor(positions), torch.tensor(0.5 * (low + high)), extent, extent, seed=seed)

    # -- Motion -------------------------------------------------------------------------------------------------------------------

    def carry(self, rest: Places, t: Time) -> Moved:
        nodes = self._with_rigid_parts(self.at(t), t)
        hyper = rest.attributes["hyper"]
        link = self.nearest(rest.points, hyper) if rest.link is None else rest.link
        m, n = len(rest.quats), len(rest.points)
        quats = rest.quats if m == n else torch.cat([rest.quats, rest.quats.new_zeros(n - m, 4)])
        points, turned = skin(rest.points, quats, hyper, link, nodes)
        return Moved(points, turned[:m], None)

    def light_at(self, t: Time) -> Tensor:
        return self.light(t)

    def links(self, primitives: PrimitiveSet) -> Tensor:
        points = primitives.rest_points().detach()
        hyper = primitives.hyper.detach().repeat_interleave(len(points) // max(len(primitives), 1), 0)
        return self.nearest(points, hyper)

    def nearest(self, points: Tensor, hyper: Tensor) -> Tensor:
        """[N, k] int32: the nodes and rigid parts that carry each of ``points`` [N, 3] with ``hyper`` [N, 2]."""
        return nearest_nodes(points, hyper, self._with_rigid_parts(self._resting(), 0.0), NEAREST)

    def priors(self, rest: Tensor, neighbours: Tensor, t: Time, dt: float) -> tuple[Tensor, Tensor]:
        """How much the graph of the nodes is strained at ``t``, as a mean share of its edges' lengths, and how much nodes change course
        over ``dt``. ``rest`` and ``neighbours`` are not used."""
        if dt <= 0 or dt > 0.5:
            now = self.at(t)
            return strain(self.positions, self.graph(), now.turns, now.shifts), torch.zeros((), device=self.positions.device)
        middle = t.clamp(dt, 1 - dt) if isinstance(t, Tensor) else min(max(t, dt), 1 - dt)
        strained, course = self._restlessness(together([t, middle - dt, middle, middle + dt]))
        return strained, course + RIGID_COURSE * self.rigid_parts.course(self.extent)

    def _restlessness_at(self, times: Tensor) -> tuple[Tensor, ...]:
        """Strain at the first of ``times`` [4], and change of course over the other three: two scalars."""
        turns, shifts = self._poses_at(times)
        change = (shifts[1] - 2 * shifts[2] + shifts[3]).norm(dim=1).mean() / self.reach
        turning = (turns[1] - 2 * turns[2] + turns[3]).norm(dim=1).mean()
        return strain(self.positions, self.graph(), turns[0], shifts[0]), change + turning

    @classmethod
    def start(cls, start: Start, views: Views, settings: TrainingSettings) -> tuple[Self, GaussianSet]:
        return cls.over(start.points, settings.seed), start.gaussians().carrying(cls.attributes)

    @classmethod
    def phases(cls, strategy: Strategy, steps: int, full_from: float, small: bool) -> list[Phase]:
        if strategy in BY_NODE_PHASES:
            return node_phases(steps, 1.0 if small else HALF_RESOLUTION)
        return super().phases(strategy, steps, full_from, small)

    @classmethod
    def first_training(cls, strategy: Strategy, steps: int, small: bool) -> FirstTraining | None:
        return first_motion(strategy, steps, small)

    def rate(self, name: str, settings: TrainingSettings, unit: float, scale: float) -> Rate:
        if name == "log_radii":
            return exponential(5e-3 * scale, 5e-4)
        if name == "hyper":
            return exponential(1e-4 * unit * scale, 1e-5 * unit)
        if name.startswith("rigid_parts."):
            first, last = (1e-2 if scale == 1 else 1e-4), 1e-4
            return exponential(first, last) if name == "rigid_parts.quats" else exponential(first * unit / 4, last * unit / 4)
        # Nodes end at a fiftieth: each of their parameters moves thousands of primitives, and jitter at the end would blur all of them.
        return exponential(settings.lr_network if scale == 1 else settings.lr_network / 50, settings.lr_network / 50)

    def attribute_rates(self, settings: TrainingSettings, unit: float, scale: float) -> dict[str, Rate]:
        return {
            "hyper": exponential(1e-4 * unit * scale, 1e-5 * unit),
            "shades": exponential(3e-3 * scale, 3e-3 * APPEARANCE_END),
        }

    # -- the nodes ----------------------------------------------------------------------------------------------------------------

    def at(self, t: Time) -> Nodes:
        """The nodes at time ``t``, clamped to [0, 1], without the rigid parts."""
        return self.at_times(together([t]))[0]

    def at_times(self, times: Sequence[float] | Tensor) -> list[Nodes]:
        """`at` for each of ``times``."""
        resting = self._resting()
        turns, shifts = self._poses(times)
        return [resting._replace(turns=turn, shifts=shift) for turn, shift in zip(turns, shifts)]

    def _poses_at(self, times: Tensor) -> tuple[Tensor, ...]:
        """Unit quaternions [T, B, 4] and shifts [T, B, 3] of the nodes at ``times`` [T]."""
        out = OUTPUT * self.network(self._place(), times)
        quats = torch.cat([1 + out[..., :1], out[..., 1:4]], 2)
        return quats / quats.norm(dim=2, keepdim=True).clamp(min=1e-6), self.reach * out[..., 4:]

    def graph(self) -> Tensor:
        """[B, k] indices of each node's nearest neighbours."""
        return self._once("graph", lambda p: distances(p, p).topk(min(GRAPH, len(p) - 1) + 1, largest=False).indices[:, 1:])

    def _place(self) -> Tensor:
        """[B, 33] encoded rest positions of the nodes, as the network takes them."""
        return self._once("place", lambda p: encode_places((p - self.centre) / self.extent))

    def remember(self) -> None:
        """Compute what depends only on the rest positions, before a CUDA graph is captured that reads it."""
        self.graph(), self._place()

    def _once(self, name: str, of: Callable[[Tensor], Tensor]) -> Tensor:
        """Cache for values that depend only on the rest positions, which change only when the module is moved or loaded."""
        known = self._known.get(name)
        if known is None:
            known = of(self.positions)
            # What is computed in a capture lies in the graphs' memory, where replays of other graphs write.
            if not in_capture(self.positions.device):
                self._known[name] = known
        return known

    def _apply(self, *args: Any, **kwargs: Any) -> ControlNodes:
        """Where torch moves a module or changes its type."""
        super()._apply(*args, **kwargs)
        self._forget()
        return self

    def _load_from_state_dict(self, *args: Any, **kwargs: Any) -> None:
        """Where torch gives a module its part of a state."""
        super()._load_from_state_dict(*args, **kwargs)
        self._forget()

    def _forget(self) -> None:
        self._known.clear()
        self._poses.forget()
        self._restlessness.forget()

    def _resting(self) -> Nodes:
        none = self.positions.new_zeros(0)
        return Nodes(self.positions, self.hyper, 0.5 * torch.exp(-2 * self.log_radii), none, none)

    def _with_rigid_parts(self, nodes: Nodes, t: Time) -> Nodes:
        rigid_parts = self.rigid_parts
        if not len(rigid_parts):
            return nodes
        turns, shifts = rigid_parts.pose(t.clamp(0, 1) if isinstance(t, Tensor) else min(max(float(t), 0.0), 1.0))
        theirs = Nodes(rigid_parts.home, rigid_parts.hyper(self.extent), 0.5 / rigid_parts.radius.square(), turns, shifts)
        return Nodes(*(torch.cat([own, other]) if len(own) else own for own, other in zip(nodes, theirs)))

    # -- rigid parts --------------------------------------------------------------------------------------------------------------

    def with_turning_parts(self, scene: Scene, views: Views, error: Tensor, seed: int, say: Callable[[str], None]) -> Refined | None:
        found = make_turning_parts_rigid(self, scene, views, error, seed, say)
        return None if found is None else Refined(*found)

    def in_rigid_parts(self, scene: Scene) -> Tensor:
        link = scene.links(scene.gaussians)
        assert link is not None
        return link[:, 0] >= len(self.positions)

    def leave_only_rigid_parts(self, scene: Scene, parameters: Mapping[str, Tensor]) -> None:
        leave_only(self.in_rigid_parts(scene), parameters, "motion.rigid_parts.")

    def with_rigid_parts(self, rigid_parts: RigidParts) -> Self:
        """The same nodes with ``rigid_parts`` in place of the current ones."""
        nodes = type(self)(self.positions, self.centre, self.extent, self.reach, rigid_parts=rigid_parts)
        nodes.network, nodes.light, nodes.log_radii, nodes.hyper = self.network, self.light, self.log_radii, self.hyper
        return nodes

    @torch.no_grad()
    def spread_over(self, points: np.ndarray) -> ControlNodes:
        """The same network with nodes spread again over ``points`` [P, 3], at most as many as now. Each new node takes the hyper
        coordinates of the nearest old one."""
        positions = torch.tensor(farthest_points(points, len(self.positions)), dtype=torch.float32, device=self.positions.device)
        nodes = ControlNodes(positions, self.centre, self.extent, self.reach, rigid_parts=self.rigid_parts)
        nodes.network, nodes.light = self.network, self.light
        nodes.hyper.copy_(self.hyper[distances(positions, self.positions).argmin(1)])
        return nodes
