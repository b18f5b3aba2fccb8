"""The deformation field composed of torch operations: look-up, product, MLP, heads, rotation, in any float type.

Built from the `state_dict` of a `DeformationField`, whose values it copies. In float64 it is the field's oracle; in float32 it is what a
good user of torch would train: planes channels-first for `grid_sample`, one call for three planes, or look-ups by index.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

import torch
import torch.nn.functional as F
from e4dgs.scene.motion.carrier import Carrier
from e4dgs.scene.motion.planes.displacement import Displacement
from e4dgs.scene.motion.planes.field import DeformationField
from e4dgs.scene.motion.planes.hexplane import lookup_reference
from e4dgs.scene.rotation import rotate
from torch import Tensor, nn

Lookup = Literal["grid_sample", "gather"]
AXES = (0, 0, 1), (1, 2, 2)  # of the planes xy, xz, yz: first and second coordinate


class TorchField(Carrier):
    """The same motion as `DeformationField`.

    state: of the field to copy. lookup: "grid_sample" on planes [3, C, R, R], or "gather" on planes [3, R, R, C].
    """

    kind = "torch"
    low: Tensor
    high: Tensor

    def __init__(self, state: Mapping[str, Tensor], dtype: torch.dtype = torch.float32, lookup: Lookup = "grid_sample") -> None:
        super().__init__()
        self.lookup = lookup
        self.register_buffer("low", state["low"].to(dtype))
        self.register_buffer("high", state["high"].to(dtype))
        levels = sum(name.startswith("planes.space.") for name in state)
        planes = {
            kind: [self._laid_out(state[f"planes.{kind}.{level}"].to(dtype)) for level in range(levels)] for kind in ("space", "time")
        }
        self.space = nn.ParameterList([nn.Parameter(p) for p in planes["space"]])
        self.time = nn.ParameterList([nn.Parameter(p) for p in planes["time"]])
        hidden, features = state["trunk.0.weight"].shape
        self.trunk = nn.Sequential(nn.Linear(features, hidden), nn.ReLU(), nn.Linear(hidden, hidden), nn.ReLU())
        self.head = nn.Linear(hidden, state["head.weight"].shape[0])
        for part, layers in (("trunk", self.trunk), ("head", self.head)):
            layers.to(dtype).load_state_dict(
                {k.removeprefix(part + "."): v.to(dtype) for k, v in state.items() if k.startswith(part + ".")}
            )

    def _laid_out(self, planes: Tensor) -> Tensor:
        """A copy of planes [3, rows, columns, C] in the order that the look-up reads."""
        return (planes.permute(0, 3, 1, 2) if self.lookup == "grid_sample" else planes).contiguous().clone()

    def gradients(self) -> dict[str, Tensor]:
        """Gradients by the names and shapes of `DeformationField`'s parameters."""
        found = {}
        for name, p in self.named_parameters():
            assert p.grad is not None
            plane = name.startswith(("space.", "time."))
            grad = p.grad.permute(0, 2, 3, 1) if plane and self.lookup == "grid_sample" else p.grad
            found[f"planes.{name}" if plane else name] = grad
        return found

    def features(self, u: Tensor, t: float) -> Tensor:
        """[N, C * levels] at positions ``u`` [N, 3] in [0, 1]."""
        if self.lookup == "gather":
            return lookup_reference(u, t, *[p for pair in zip(self.space, self.time) for p in pair])
        first, second = (u[:, list(axes)].T for axes in AXES)  # [3, N]
        in_space = (2 * torch.stack([first, second], -1) - 1)[:, None]  # [3, 1, N, 2]: x runs along columns
        in_time = (2 * torch.stack([u.T, torch.full_like(u.T, t)], -1) - 1)[:, None]
        out = []
        for space, time in zip(self.space, self.time):
            a = F.grid_sample(space, in_space, mode="bilinear", padding_mode="border", align_corners=True)[:, :, 0]
            b = F.grid_sample(time, in_time, mode="bilinear", padding_mode="border", align_corners=True)[:, :, 0]
            out.append(a[0] * a[1] * a[2] * b[0] * b[1] * b[2])
        return torch.cat(out).T

    def inputs(self, rest: Tensor, t: float) -> Tensor:
        """What enters the MLP."""
        return self.features((rest.detach() - self.low) / (self.high - self.low), t)

    def forward(self, rest: Tensor, t: float) -> Displacement:
        out = self.head(self.trunk(self.inputs(rest, t)))
        turn = torch.cat([1 + out[:, 3:4], out[:, 4:7]], 1)
        turn = turn / turn.norm(dim=1, keepdim=True).clamp(min=1e-6)
        arm = rest - 0.5 * (self.low + self.high)
        reach = 0.25 * (self.high - self.low).norm()
        return Displacement(rotate(turn, arm) - arm + out[:, :3] * reach, turn, out[:, 7:10])

    def rigid_motion(self, rest: Tensor, t: float) -> Tensor:
        return self.head(self.trunk(self.inputs(rest, t)))[:, :7]

    def priors(self, rest: Tensor, neighbours: Tensor, t: float, dt: float) -> tuple[Tensor, Tensor]:
        """As `DeformationField.priors`."""
        here, there = self.rigid_motion(torch.cat([rest, neighbours]), t).chunk(2)
        rigidity = (here - there).norm(dim=1).mean()
        if dt > 0.5 or dt <= 0:
            return rigidity, torch.zeros(())
        middle = min(max(t, dt), 1 - dt)
        if middle != t:
            here = self.rigid_motion(rest, middle)
        change = self.rigid_motion(rest, middle - dt) - 2 * here + self.rigid_motion(rest, middle + dt)
        return rigidity, change.norm(dim=1).mean()

    priors_at_places = True
    worth_culling = True
    replayable = False
    carry, rate = DeformationField.carry, DeformationField.rate

    def regulariser(self) -> Tensor:
        """As `HexPlanes.total_variation`."""
        first = 2 if self.lookup == "grid_sample" else 1
        terms = []
        for space, time in zip(self.space, self.time):
            terms += [space.diff(dim=first), space.diff(dim=first + 1), time.diff(dim=first + 1)]
            if time.shape[first] > 2:
                terms.append(time.diff(n=2, dim=first))
        return torch.stack([term.square().mean() for term in terms if term.numel()]).sum()
