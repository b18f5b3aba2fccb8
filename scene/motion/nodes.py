"""Control nodes: a few rigid frames that travel through the scene and carry the primitives near them.

The second implementation of `Motion`. Where every time is seen by one camera from another side, the images say too little for a
field that may bend anywhere; a few dozen rotations and translations at a few keys in time are all that they can settle.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor, nn

from ..rotation import compose, rotate
from .interface import Displacement

NEAREST = 4  # nodes that share a position
GRAPH = 6  # neighbours of a node in the rigidity term


class ControlNodes(nn.Module):
    """Implements `Motion` by linear blend skinning over the nearest nodes. Nodes start at rest.

    Trajectories are piecewise linear between keys at equal distances over [0, 1]. Parameters: ``quats`` [T, B, 4] (w x y z, of any norm
    but zero) turn a node about its own rest position, ``shifts`` [T, B, 3] move it, in units of ``reach``.

    Args:
        positions: [B, 3] rest positions, world units.
        keys: T.
        reach: world units of one unit of ``shifts``.
        exclusive: [B] world units. A node of a positive value is a rigid body: it alone moves everything within that distance, and
            nothing else. None: there are no such nodes.
    """

    positions: Tensor
    exclusive: Tensor
    spread: Tensor
    opened: Tensor

    def __init__(self, positions: Tensor, keys: int, reach: float, exclusive: Tensor | None = None) -> None:
        super().__init__()
        positions = torch.as_tensor(positions).float()
        count, device = len(positions), positions.device
        self.register_buffer("positions", positions.clone())
        self.register_buffer("exclusive", torch.zeros(count, device=device) if exclusive is None else exclusive.float().clone())
        # A node's influence falls off over the distance to its third neighbour; a lone node carries everything.
        near = min(3, count - 1)
        gap = torch.cdist(positions, positions).topk(near + 1, largest=False).values[:, 1:] if near else torch.ones(count, 1, device=device)
        self.register_buffer("spread", gap.mean(1).clamp(min=1e-6))
        self.register_buffer("opened", torch.tensor([(keys - 1) // 2, keys // 2], device=device))
        self.quats = nn.Parameter(torch.tensor([1.0, 0.0, 0.0, 0.0], device=device).repeat(keys, count, 1))
        self.shifts = nn.Parameter(torch.zeros(keys, count, 3, device=device))
        self.reach = reach

    @property
    def keys(self) -> int:
        return self.quats.shape[0]

    @property
    def config(self) -> dict[str, object]:
        """What `from_state` needs beside the state."""
        return {"kind": "nodes", "keys": self.keys, "reach": self.reach}

    @classmethod
    def from_state(cls, state: dict[str, Tensor], config: dict) -> ControlNodes:
        """Inverse of `state_dict` and `config`."""
        nodes = cls(state["positions"], config["keys"], config["reach"], state["exclusive"])
        nodes.load_state_dict(state)
        return nodes

    # -- Motion -------------------------------------------------------------------------------------------------------------------

    def forward(self, rest: Tensor, t: float) -> Displacement:
        weights, index = self.skinning(rest)
        quats, shifts = self.pose(t)
        turns = quats[index]
        side = torch.sign((turns * turns[:, :1]).sum(2, keepdim=True)).detach()  # q and -q turn alike, their sum does not
        blended = (weights[..., None] * torch.where(side == 0, torch.ones_like(side), side) * turns).sum(1)
        turn = blended / blended.norm(dim=1, keepdim=True).clamp(min=1e-6)
        n, k = index.shape
        origin = self.positions[index]
        arm = rotate(turns.reshape(-1, 4), (rest[:, None] - origin).reshape(-1, 3)).reshape(n, k, 3)
        moved = (weights[..., None] * (arm + origin + shifts[index])).sum(1)
        return Displacement(moved - rest, turn, torch.zeros_like(rest))

    def priors(self, rest: Tensor, neighbours: Tensor, t: float, dt: float) -> tuple[Tensor, Tensor]:
        """How much the graph of the nodes is strained at ``t``, as a mean share of its edges' lengths, and how much nodes change course
        from key to key. The positions that the caller offers are not needed. Rigid bodies take no part in the first."""
        quats, shifts = self.pose(t)
        now = self.positions + shifts
        free = (self.exclusive == 0).nonzero()[:, 0]
        rigidity = torch.zeros((), device=self.positions.device)
        if len(free) > 1:
            home = self.positions[free]
            gaps = torch.cdist(home, home)
            edge = free[gaps.topk(min(GRAPH, len(free) - 1) + 1, largest=False).indices[:, 1:]]
            b, k = edge.shape
            at_rest = self.positions[edge] - home[:, None]
            turned = rotate(quats[free][:, None].expand(b, k, 4).reshape(-1, 4), at_rest.reshape(-1, 3)).reshape(b, k, 3)
            strain = (now[edge] - now[free][:, None] - turned).norm(dim=2) / at_rest.norm(dim=2).clamp(min=1e-6)
            rigidity = strain.mean()
        low, high = self.opened.tolist()
        course = torch.zeros((), device=self.positions.device)
        if high - low >= 2:
            course = sum((p[low : high + 1].diff(n=2, dim=0).norm(dim=2).mean() for p in (self.quats, self.shifts)), course)
        return rigidity, course

    def regulariser(self) -> Tensor:
        """Nodes have no planes to smooth."""
        return torch.zeros((), device=self.positions.device)

    def extend(self, low: float, high: float) -> None:
        """Frames of the times from ``low`` to ``high`` are about to be seen: keys that come in go on as the two before them went."""
        first, last = self.opened.tolist()
        for k in range(last + 1, min(int(np.ceil(high * (self.keys - 1) - 1e-9)) + 1, self.keys)):
            self._continue(k, k - 1, k - 2)
            last = k
        for k in range(first - 1, max(int(np.floor(low * (self.keys - 1) + 1e-9)), 0) - 1, -1):
            self._continue(k, k + 1, k + 2)
            first = k
        self.opened.copy_(torch.tensor([first, last]))

    # -- trajectories -------------------------------------------------------------------------------------------------------------

    def skinning(self, rest: Tensor) -> tuple[Tensor, Tensor]:
        """Weights [N, k], which sum to one, and node indices [N, k] for ``rest`` [N, 3]. No gradients."""
        with torch.no_grad():
            distance = torch.cdist(rest.detach(), self.positions)
            bodies = self.exclusive > 0
            inside = (distance < self.exclusive) & bodies
            distance = torch.where(bodies & ~inside, torch.inf, distance)
            distance = torch.where(inside, -1.0, distance)  # nearer than any free node
            value, index = distance.topk(min(NEAREST, len(self.positions)), largest=False)
            weights = torch.exp(-0.5 * (value / self.spread[index]) ** 2) + 1e-8
            weights = torch.where(torch.isinf(value), 0.0, weights)
            owned = value[:, :1] < 0
            alone = torch.zeros_like(weights)
            alone[:, 0] = 1.0
            weights = torch.where(owned, alone, weights)
            total = weights.sum(1, keepdim=True)
            return torch.where(total > 0, weights / total.clamp(min=1e-12), 1.0 / weights.shape[1]), index

    def pose(self, t: float) -> tuple[Tensor, Tensor]:
        """Unit quaternions [B, 4] and shifts [B, 3] in world units at time ``t``, clamped to [0, 1]."""
        x = min(max(float(t), 0.0), 1.0) * (self.keys - 1)
        low = min(int(x), max(self.keys - 2, 0))
        high, f = min(low + 1, self.keys - 1), x - low
        quats = self.quats[low] * (1 - f) + self.quats[high] * f
        quats = quats / quats.norm(dim=1, keepdim=True).clamp(min=1e-6)
        return quats, (self.shifts[low] * (1 - f) + self.shifts[high] * f) * self.reach

    @torch.no_grad()
    def _continue(self, k: int, before: int, earlier: int) -> None:
        """Key ``k`` by constant velocity from the two keys on its inner side, or the pose of the one if there is no second."""
        if not 0 <= earlier < self.keys:
            self.quats[k], self.shifts[k] = self.quats[before], self.shifts[before]
            return
        quat = nn.functional.normalize(self.quats[before], dim=1)
        inverse = nn.functional.normalize(self.quats[earlier], dim=1) * torch.tensor([1.0, -1.0, -1.0, -1.0], device=self.quats.device)
        self.quats[k] = compose(compose(quat, inverse), quat)
        self.shifts[k] = 2 * self.shifts[before] - self.shifts[earlier]

    @torch.no_grad()
    def resampled(self, positions: Tensor, keys: int) -> ControlNodes:
        """Other nodes at ``positions`` [B', 3] at rest with other ``keys``, which go where these would carry them. All keys are open."""
        nodes = ControlNodes(positions, keys, self.reach)
        poses = [self(nodes.positions, k / max(keys - 1, 1)) for k in range(keys)]
        nodes.quats.copy_(aligned(torch.stack([pose.dr for pose in poses])))
        nodes.shifts.copy_(torch.stack([pose.dx for pose in poses]) / self.reach)
        nodes.opened.copy_(torch.tensor([0, keys - 1]))
        return nodes

    @torch.no_grad()
    def with_body(self, centre: Tensor, radius: float, quats: Tensor, path: Tensor) -> ControlNodes:
        """A rigid body in place of the nodes within ``radius`` of ``centre`` [3] at rest: ``quats`` [T, 4] turn it, its centre goes along
        ``path`` [T, 3], both at the keys."""
        keep = ((self.positions - centre).norm(dim=1) > radius).nonzero()[:, 0]
        positions = torch.cat([self.positions[keep], centre[None]])
        nodes = ControlNodes(positions, self.keys, self.reach, torch.cat([self.exclusive[keep], self.exclusive.new_tensor([radius])]))
        nodes.quats.copy_(torch.cat([self.quats[:, keep], aligned(quats[:, None])], 1))
        nodes.shifts.copy_(torch.cat([self.shifts[:, keep], (path - centre)[:, None] / self.reach], 1))
        nodes.opened.copy_(self.opened)
        return nodes


def aligned(quats: Tensor) -> Tensor:
    """``quats`` [T, B, 4] with signs such that each is on the side of the one before, so that interpolation takes the short way."""
    flips = torch.sign((quats[1:] * quats[:-1]).sum(2, keepdim=True))
    flips = torch.where(flips == 0, torch.ones_like(flips), flips).cumprod(0)
    return torch.cat([quats[:1], quats[1:] * flips])


def farthest_points(points: np.ndarray, count: int) -> np.ndarray:
    """Up to ``count`` of ``points`` [P, 3], each as far as can be from those before it; starts at the one nearest to the mean."""
    first = int(np.linalg.norm(points - points.mean(0), axis=1).argmin())
    chosen = [first]
    distance = np.linalg.norm(points - points[first], axis=1)
    while len(chosen) < min(count, len(points)) and distance.max() > 0:
        chosen.append(int(distance.argmax()))
        distance = np.minimum(distance, np.linalg.norm(points - points[chosen[-1]], axis=1))
    return points[chosen]
