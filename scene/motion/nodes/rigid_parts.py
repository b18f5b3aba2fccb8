"""Rigid parts among the control nodes: parts whose turn was found by search. Each has its own keyframes instead of the network."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from ..times import Time

# Distance of a rigid part from everything else, in extents, along the first hyper coordinate: no other node is near its own Gaussians.
FAR = 10.0


class RigidParts(nn.Module):
    """b rigid parts, whose poses are interpolated linearly between keys that are evenly spaced over [0, 1].

    Parameters: ``quats`` [T, b, 4] (w x y z, any nonzero norm) turn a rigid part about its own rest position; ``shifts`` [T, b, 3] in world
    units move it. Buffers: rest positions ``home`` [b, 3] and ``radius`` [b], world units.
    """

    home: Tensor
    radius: Tensor

    def __init__(self, home: Tensor, radius: Tensor, quats: Tensor, shifts: Tensor) -> None:
        super().__init__()
        self.register_buffer("home", home.float().clone())
        self.register_buffer("radius", radius.float().clone())
        self.quats = nn.Parameter(aligned(quats.float()))
        self.shifts = nn.Parameter(shifts.float().clone())

    def __len__(self) -> int:
        return len(self.home)

    @staticmethod
    def none(device: torch.device | str = "cpu") -> RigidParts:
        shapes = (0, 3), (0,), (1, 0, 4), (1, 0, 3)
        return RigidParts(*(torch.zeros(shape, device=device) for shape in shapes))

    def hyper(self, extent: float) -> Tensor:
        """[b, 2] hyper coordinates of the rigid parts, for nodes that spread over ``extent`` (world units)."""
        beside = torch.zeros(len(self), 2, device=self.home.device)
        beside[:, 0] = FAR * extent * torch.arange(1, len(self) + 1, device=self.home.device)
        return beside

    def pose(self, t: Time) -> tuple[Tensor, Tensor]:
        """Unit quaternions [b, 4] and shifts [b, 3] at time ``t`` in [0, 1]."""
        last = len(self.quats) - 1
        x = t * last
        f: Time
        if isinstance(x, Tensor):  # whose value is not known here
            key = x.long().clamp(max=max(last - 1, 0))
            keys = key, (key + 1).clamp(max=last)
            before, after = ([p.index_select(0, at[None])[0] for p in (self.quats, self.shifts)] for at in keys)
            f = x - key
        else:
            low = min(int(x), max(last - 1, 0))
            before, after = ([p[at] for p in (self.quats, self.shifts)] for at in (low, min(low + 1, last)))
            f = x - low
        quats, shifts = (a * (1 - f) + b * f for a, b in zip(before, after))
        return quats / quats.norm(dim=1, keepdim=True).clamp(min=1e-6), shifts

    def course(self, extent: float) -> Tensor:
        """How unsteadily the rigid parts move from key to key, a scalar: the mean change of their velocities, in half radians and in units
        of ``extent`` (world units). A steady turn or a straight path at constant speed gives zero."""
        if len(self.quats) < 3 or not len(self):
            return torch.zeros((), device=self.home.device)
        quats = nn.functional.normalize(self.quats, dim=2)
        before, here, after = quats[:-2], quats[1:-1], quats[2:]
        # Unit quaternions of a steady turn satisfy q[k+1] = 2 c q[k] - q[k-1], where c is the cosine between neighbours.
        cosine = 0.5 * ((before * here).sum(2, keepdim=True) + (here * after).sum(2, keepdim=True)).detach()
        turning = (before - 2 * cosine * here + after).norm(dim=2).mean()
        return turning + self.shifts.diff(n=2, dim=0).norm(dim=2).mean() / extent

    @torch.no_grad()
    def joined(self, home: Tensor, radius: float, quats: Tensor, shifts: Tensor) -> RigidParts:
        """These rigid parts and one more at ``home`` [3] with ``radius``, ``quats`` [T, 4] and ``shifts`` [T, 3]; T is the same for all."""
        if not len(self):
            return RigidParts(home[None], home.new_tensor([radius]), quats[:, None], shifts[:, None])
        homes, radii = torch.cat([self.home, home[None]]), torch.cat([self.radius, home.new_tensor([radius])])
        return RigidParts(homes, radii, torch.cat([self.quats, quats[:, None]], 1), torch.cat([self.shifts, shifts[:, None]], 1))


def aligned(quats: Tensor) -> Tensor:
    """``quats`` [T, b, 4] with signs chosen so that each is on the same side as the one before, and interpolation takes the short way."""
    flips = torch.sign((quats[1:] * quats[:-1]).sum(2, keepdim=True))
    flips = torch.where(flips == 0, torch.ones_like(flips), flips).cumprod(0)
    return torch.cat([quats[:1], quats[1:] * flips])
