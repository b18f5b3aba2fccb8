"""Control nodes: rigid frames that travel through the scene and carry the primitives near them, as in SC-GS (Huang et al. 2024).

Where every time is seen by one camera from another side, the images say too little for a field that may bend anywhere. A few hundred
nodes whose motion comes from one small network, shared by all places and times, are what they can settle.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from ..primitives import HYPER
from ..rotation import rotate
from .bodies import Bodies
from .interface import Moved, Rest
from .skinning import Nodes, nearest_nodes, skin

NEAREST = 4  # nodes that share a position
GRAPH = 6  # neighbours of a node in the rigidity term
COURSE_SHARE = 4  # one node of so many is asked how steadily it moves, each time
WIDTH, DEPTH = 256, 4  # of the network: with 128 units a rendered creature comes to 36.5 dB in test views, with 256 to 37.6
PLACE_BANDS, TIME_BANDS = 5, 6  # octaves of the positional encoding (Tancik et al. 2020)
LEAK = 0.01  # slope below zero: units that are zero at all places and times learn nothing any more, and the first steps can bring all there
OUTPUT = 0.3  # of the heads: motion grows from rest, slowly enough to stay coherent
HYPER_SPREAD = 0.1  # of the nodes' distances, in which their hyper coordinates begin
HEADS = 1e-4  # standard deviation of the heads' first weights
BODY_COURSE = 1 / 3  # of the nodes' weight: a body that is held steadier than that never finds its way from the turn that was searched


class ControlNodes(nn.Module):
    """Implements `Motion` by linear blend skinning over the nearest nodes. Nodes start at rest.

    Parameters: the layers of the network (place and time of a node -> a turn about its rest position and a shift), ``log_radii`` [B] of
    the nodes' influence, ``hyper`` [B, 2].

    Args:
        positions: [B, 3] rest positions, world units.
        centre: [3] and extent, world units: the box that places are scaled from, fixed for the life of the network.
        reach: world units of one unit of the network's shifts.
        seed: of the network's first weights.
        bodies: rigid bodies that the network does not move.
        leak: slope of the network's units below zero.
        width: units of each of its layers.
    """

    worth_culling = False  # a look at where a position lies in the image takes as long as skinning it
    steady = False
    positions: Tensor
    centre: Tensor

    def __init__(
        self,
        positions: Tensor,
        centre: Tensor,
        extent: float,
        reach: float,
        seed: int = 0,
        bodies: Bodies | None = None,
        leak: float = LEAK,
        width: int = WIDTH,
    ) -> None:
        super().__init__()
        positions = torch.as_tensor(positions).float()
        self.register_buffer("positions", positions.clone())
        self.register_buffer("centre", torch.as_tensor(centre).float().to(positions.device))
        self.extent, self.reach, self.leak = float(extent), float(reach), float(leak)
        inputs = 3 * (1 + 2 * PLACE_BANDS) + 1 + 2 * TIME_BANDS
        generator = torch.Generator().manual_seed(seed)
        sizes = [inputs, *[width] * DEPTH, 7]
        layers = [nn.Linear(a, b) for a, b in pairwise(sizes)]
        with torch.no_grad():
            for layer in layers[:-1]:
                bound = (6.0 / layer.in_features) ** 0.5  # keeps the size of what ReLUs pass on (He et al. 2015)
                layer.weight.uniform_(-bound, bound, generator=generator)
                layer.bias.zero_()
            layers[-1].weight.normal_(0.0, HEADS, generator=generator)
            layers[-1].bias.zero_()
        self.layers = nn.ModuleList(layers)
        self.layers.to(positions.device)
        self.log_radii = nn.Parameter(spacing(positions).log())
        # Not zero: the weights do not change with coordinates that are all alike.
        beside = HYPER_SPREAD * spacing(positions).mean() * torch.randn(len(positions), HYPER, generator=generator).to(positions.device)
        self.hyper = nn.Parameter(beside)
        self.bodies = Bodies.none(positions.device) if bodies is None else bodies
        self._known: dict[str, Tensor] = {}

    @property
    def config(self) -> dict[str, object]:
        """What `from_state` needs beside the state."""
        return {"kind": "nodes", "extent": self.extent, "reach": self.reach, "leak": self.leak}

    @classmethod
    def from_state(cls, state: dict[str, Tensor], config: dict) -> ControlNodes:
        """Inverse of `state_dict` and `config`."""
        bodies = Bodies(*(state["bodies." + name] for name in ("home", "radius", "quats", "shifts")))
        leak = config.get("leak", 0.0)  # models from before there was any
        width = len(state["layers.0.bias"])
        nodes = cls(state["positions"], state["centre"], config["extent"], config["reach"], bodies=bodies, leak=leak, width=width)
        nodes.load_state_dict(state)
        return nodes

    # -- Motion -------------------------------------------------------------------------------------------------------------------

    def carry(self, rest: Rest, t: float) -> Moved:
        nodes = self._with_bodies(self.at(t), t)
        link = self.links(rest.points, rest.hyper) if rest.link is None else rest.link
        m, n = len(rest.quats), len(rest.points)
        quats = rest.quats if m == n else torch.cat([rest.quats, rest.quats.new_zeros(n - m, 4)])
        points, turned = skin(rest.points, quats, rest.hyper, link, nodes)
        return Moved(points, turned[:m], None)

    def links(self, points: Tensor, hyper: Tensor) -> Tensor:
        return nearest_nodes(points, hyper, self._with_bodies(self._resting(), 0.0), NEAREST)

    def priors(self, rest: Tensor, neighbours: Tensor, t: float, dt: float) -> tuple[Tensor, Tensor]:
        """How much the graph of the nodes is strained at ``t``, as a mean share of its edges' lengths, and how much nodes change course
        over ``dt``. The positions that the caller offers are not needed."""
        nodes = self.at(t)
        count = len(self.positions)
        none = torch.zeros((), device=self.positions.device)
        rigidity = none
        if count > 1:
            edge = self.graph()
            at_rest = self.positions[edge] - self.positions[:, None]
            turns = nodes.turns[:, None].expand(*edge.shape, 4).reshape(-1, 4)
            turned = rotate(turns, at_rest.reshape(-1, 3)).reshape(at_rest.shape)
            now = self.positions + nodes.shifts
            strain = (now[edge] - now[:, None] - turned).norm(dim=2) / at_rest.norm(dim=2).clamp(min=1e-6)
            rigidity = strain.mean()
        if dt <= 0 or dt > 0.5:
            return rigidity, none
        middle = min(max(t, dt), 1 - dt)
        some = torch.arange(round(t / dt) % COURSE_SHARE, count, COURSE_SHARE, device=self.positions.device)  # others at other times
        before, here, after = (self.at(s, some) for s in (middle - dt, middle, middle + dt))
        shifts = (before.shifts - 2 * here.shifts + after.shifts).norm(dim=1).mean() / self.reach
        turning = (before.turns - 2 * here.turns + after.turns).norm(dim=1).mean()
        return rigidity, shifts + turning + BODY_COURSE * self.bodies.course(self.extent)

    def regulariser(self) -> Tensor:
        """Nodes have no planes to smooth."""
        return torch.zeros((), device=self.positions.device)

    # -- the nodes ----------------------------------------------------------------------------------------------------------------

    def at(self, t: float, some: Tensor | None = None) -> Nodes:
        """The nodes, or ``some`` of them by number, at time ``t``, clamped to [0, 1]. Bodies are not among them."""
        resting, place = self._resting(), self._place()
        if some is not None:
            resting, place = Nodes(*(p[some] if len(p) else p for p in resting)), place[some]
        time = encode(self.positions.new_tensor([[min(max(float(t), 0.0), 1.0)]]), TIME_BANDS)
        hidden = torch.cat([place, time.expand(len(place), -1)], 1)
        for layer in self.layers[:-1]:
            hidden = nn.functional.leaky_relu(layer(hidden), self.leak)
        out = OUTPUT * self.layers[-1](hidden)
        quats = torch.cat([1 + out[:, :1], out[:, 1:4]], 1)
        return resting._replace(turns=quats / quats.norm(dim=1, keepdim=True).clamp(min=1e-6), shifts=self.reach * out[:, 4:])

    def graph(self) -> Tensor:
        """[B, k] numbers of each node's nearest others."""
        return self._once("graph", lambda p: torch.cdist(p, p).topk(min(GRAPH, len(p) - 1) + 1, largest=False).indices[:, 1:])

    def _place(self) -> Tensor:
        """[B, inputs] where the nodes rest, as the network takes it."""
        return self._once("place", lambda p: encode((p - self.centre) / self.extent, PLACE_BANDS))

    def _once(self, name: str, of: Callable[[Tensor], Tensor]) -> Tensor:
        """What depends on the rest positions alone, which change only where the module is moved or loaded."""
        if name not in self._known:
            self._known[name] = of(self.positions)
        return self._known[name]

    def _apply(self, *args: Any, **kwargs: Any) -> ControlNodes:
        """Where torch moves a module or changes its type."""
        super()._apply(*args, **kwargs)
        self._known.clear()
        return self

    def _load_from_state_dict(self, *args: Any, **kwargs: Any) -> None:
        """Where torch gives a module its part of a state."""
        super()._load_from_state_dict(*args, **kwargs)
        self._known.clear()

    def _resting(self) -> Nodes:
        none = self.positions.new_zeros(0)
        return Nodes(self.positions, self.hyper, 0.5 * torch.exp(-2 * self.log_radii), none, none)

    def _with_bodies(self, nodes: Nodes, t: float) -> Nodes:
        bodies = self.bodies
        if not len(bodies):
            return nodes
        turns, shifts = bodies.pose(min(max(float(t), 0.0), 1.0))
        theirs = Nodes(bodies.home, bodies.hyper(self.extent), 0.5 / bodies.radius.square(), turns, shifts)
        return Nodes(*(torch.cat([own, other]) if len(own) else own for own, other in zip(nodes, theirs)))

    def in_bodies(self, link: Tensor | None) -> Tensor:
        """[N] bool: what ``link`` [N, k] binds to a rigid body."""
        assert link is not None
        return link[:, 0] >= len(self.positions)

    def with_bodies(self, bodies: Bodies) -> ControlNodes:
        """The same nodes beside ``bodies``."""
        nodes = ControlNodes(self.positions, self.centre, self.extent, self.reach, bodies=bodies, leak=self.leak)
        nodes.layers, nodes.log_radii, nodes.hyper = self.layers, self.log_radii, self.hyper
        return nodes

    @torch.no_grad()
    def spread_over(self, points: np.ndarray) -> ControlNodes:
        """The same network with nodes spread anew over ``points`` [P, 3], at most as many as here, which keep the hyper coordinates of
        the nearest node."""
        positions = torch.tensor(farthest_points(points, len(self.positions)), dtype=torch.float32, device=self.positions.device)
        nodes = ControlNodes(positions, self.centre, self.extent, self.reach, bodies=self.bodies, leak=self.leak)
        nodes.layers = self.layers
        nodes.hyper.copy_(self.hyper[torch.cdist(positions, self.positions).argmin(1)])
        return nodes


def spacing(positions: Tensor) -> Tensor:
    """[B] mean distance of each of ``positions`` [B, 3] to its three nearest others; 1 for a lone one."""
    near = min(3, len(positions) - 1)
    if not near:
        return torch.ones(len(positions), device=positions.device)
    return torch.cdist(positions, positions).topk(near + 1, largest=False).values[:, 1:].mean(1).clamp(min=1e-6)


def encode(x: Tensor, bands: int) -> Tensor:
    """``x`` [N, d] beside its sines and cosines at ``bands`` octaves: [N, d (1 + 2 bands)]."""
    scaled = x[:, None] * (2.0 ** torch.arange(bands, device=x.device, dtype=x.dtype))[:, None]
    return torch.cat([x, torch.sin(scaled).flatten(1), torch.cos(scaled).flatten(1)], 1)


def farthest_points(points: np.ndarray, count: int) -> np.ndarray:
    """Up to ``count`` of ``points`` [P, 3], each as far as can be from those before it; starts at the one nearest to the mean."""
    first = int(np.linalg.norm(points - points.mean(0), axis=1).argmin())
    chosen = [first]
    distance = np.linalg.norm(points - points[first], axis=1)
    while len(chosen) < min(count, len(points)) and distance.max() > 0:
        chosen.append(int(distance.argmax()))
        distance = np.minimum(distance, np.linalg.norm(points - points[chosen[-1]], axis=1))
    return points[chosen]
