"""The deformation field D of the paper: six planes, a small MLP, heads for displacement, rotation and scale."""

from __future__ import annotations

from typing import Any, Self

import numpy as np
import torch
from torch import Tensor, nn

from ...primitives import GaussianSet
from ...rotation import compose
from ...settings import TrainingSettings
from ...views import Views
from ..carrier import Carrier, Places
from ..interface import Moved
from ..rates import Rate, exponential
from ..start import Start
from ..times import Time
from .displace import displace
from .displacement import Displacement
from .field_kernel import field_outputs
from .hexplane import HexPlanes

LEAST_DYNAMIC = 50  # dynamic seeds, from which on the field spans only these


class DeformationField(Carrier):
    """The field as a motion. Heads start at zero, so an untrained field moves nothing.

    ``reach``: world units for one unit of the displacement head, a quarter of the box's diagonal. It is kept as a Python float, so that a
    GPU is synchronised when the field is created, loaded or moved, but not when it is used.

    Args:
        low, high: [3] corners of the box (world units) that the planes cover; positions outside are clamped to its faces. The field is
            created on their device.
        times: number of distinct times in the capture, the resolution of the time planes.
        resolutions: spatial resolution of each level.
        channels: features of a level.
        width: of the MLP's hidden layers.
        seed: of the initial values.
    """

    low: Tensor
    high: Tensor
    reach: float

    kind = "planes"
    worth_culling = True
    priors_at_places = True
    played_as = "paths"
    replayable = False  # the look-up needs the time on the CPU

    def __init__(
        self,
        low: Tensor,
        high: Tensor,
        times: int,
        resolutions: tuple[int, ...] = (16, 32),
        channels: int = 16,
        width: int = 64,
        seed: int = 0,
    ) -> None:
        super().__init__()
        size = (high - low).float()
        # A flat box (a point or a plane) would cause a division by zero: every axis gets at least a thousandth of the longest one.
        size = torch.maximum(size, (size.max() * 1e-3).clamp(min=1e-6))
        self.register_buffer("low", low.float().clone())
        # Far from the origin, rounding may make a small size vanish.
        self.register_buffer("high", torch.maximum(low.float() + size, torch.nextafter(self.low, torch.full_like(self.low, torch.inf))))
        self.planes = HexPlanes(resolutions, times, channels, seed)
        generator = torch.Generator().manual_seed(seed + 1)
        self.trunk = nn.Sequential(nn.Linear(self.planes.features, width), nn.ReLU(), nn.Linear(width, width), nn.ReLU())
        self.head = nn.Linear(width, 10)
        with torch.no_grad():
            for layer in (self.trunk[0], self.trunk[2]):
                assert isinstance(layer, nn.Linear)
                bound = (6.0 / layer.in_features) ** 0.5
                layer.weight.copy_(torch.rand(layer.weight.shape, generator=generator) * 2 * bound - bound)
                layer.bias.zero_()
            self.head.weight.zero_()
            self.head.bias.zero_()
        self.to(low.device)  # the initial values are the same on every device
        self._sizes = {"times": times, "resolutions": list(resolutions), "channels": channels, "width": width}

    @property
    def config(self) -> dict[str, Any]:
        return {"kind": self.kind, **self._sizes}

    @classmethod
    def over(cls, points: np.ndarray, times: int, seed: int = 0) -> Self:
        """A field over the bounding box of ``points`` [P, 3], widened by a fifth. The box spans the 1st to the 99th percentile, so outliers
        do not stretch it."""
        low, high = np.percentile(points, 1, axis=0), np.percentile(points, 99, axis=0)
        margin = 0.2 * (high - low).max()
        return cls(torch.tensor(low - margin), torch.tensor(high + margin), times, seed=seed)

    @classmethod
    def start(cls, start: Start, views: Views, settings: TrainingSettings) -> tuple[Self, GaussianSet]:
        start = start.at_the_middle()
        points = start.points[start.dynamic] if start.dynamic.sum() >= LEAST_DYNAMIC else start.points
        return cls.over(points, len(np.unique(views.time)), settings.seed), start.gaussians()

    @classmethod
    def from_state(cls, state: dict[str, Tensor], config: dict[str, Any]) -> Self:
        field = cls(
            state["low"], state["high"], config["times"], tuple(config["resolutions"]), channels=config["channels"], width=config["width"]
        )
        field.load_state_dict(state)
        return field

    def _apply(self, *args: Any, **kwargs: Any) -> DeformationField:
        """Where torch moves a module or changes its type."""
        super()._apply(*args, **kwargs)
        self._measure()
        return self

    def _load_from_state_dict(self, *args: Any, **kwargs: Any) -> None:
        """Where torch gives a module its part of a state."""
        super()._load_from_state_dict(*args, **kwargs)
        self._measure()

    def _measure(self) -> None:
        self.reach = 0.25 * float((self.high.cpu() - self.low.cpu()).norm())

    def _heads(self, rest: Tensor, t: float) -> Tensor:
        layers = [layer for layer in (*self.trunk, self.head) if isinstance(layer, nn.Linear)]
        weights = [p for layer in layers for p in (layer.weight, layer.bias)]
        return field_outputs(list(self.planes.space), list(self.planes.time), weights, rest, (self.low, self.high), t)

    def forward(self, rest: Tensor, t: float) -> Displacement:
        """The displacement at ``t``. The heads give each place a rotation about the box's centre and a translation. All points of a rigid
        part share both, however it turns, and the gradient of a rest position is rotated with the part."""
        return displace(self._heads(rest, t), rest, 0.5 * (self.low + self.high), self.reach)

    def carry(self, rest: Places, t: Time) -> Moved:
        dx, dr, ds = self(rest.points, float(t))
        m = len(rest.quats)
        return Moved(rest.points + dx, compose(dr[:m], rest.quats), ds[:m])

    def rigid_motion(self, rest: Tensor, t: float) -> Tensor:
        """[N, 7] numbers of order one that are equal for all positions that move as one rigid part."""
        return self._heads(rest, t)[:, :7]

    def priors(self, rest: Tensor, neighbours: Tensor, t: Time, dt: float) -> tuple[Tensor, Tensor]:
        """Mean norms of two differences of `rigid_motion`: between ``rest`` and ``neighbours``, and the second difference in time."""
        t = float(t)
        now = self.rigid_motion(torch.cat([rest, neighbours]), t)
        here, there = now.chunk(2)
        rigidity = (here - there).norm(dim=1).mean()
        middle = min(max(t, dt), 1 - dt)
        if dt > 0.5 or dt <= 0:
            return rigidity, torch.zeros((), device=rest.device)
        if middle != t:
            here = self.rigid_motion(rest, middle)
        change = self.rigid_motion(rest, middle - dt) - 2 * here + self.rigid_motion(rest, middle + dt)
        return rigidity, change.norm(dim=1).mean()

    def regulariser(self) -> Tensor:
        return self.planes.total_variation()

    def rate(self, name: str, settings: TrainingSettings, unit: float, scale: float) -> Rate:
        first = settings.lr_field if name.startswith("planes.") else settings.lr_network
        return exponential(first * scale, first / 10)
