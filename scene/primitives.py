"""Gaussians and convexes as sets of unconstrained parameters: what the optimiser sees and what is saved."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import ClassVar, NamedTuple, Self

import numpy as np
import torch
from torch import Tensor

from .cpu.looks import look
from .rotation import quats_to_matrices

SH_C0 = 0.28209479177387814  # value of the degree-0 spherical harmonic
TAU_RADIUS = 20.0  # initial tau of a convex times its radius: the smooth maximum exceeds the true one by at most ln K / 20 of the radius
REACH = 1.9  # standard deviations from a Gaussian's mean to the points of the convex that takes its place
KAPPA_REACH = 20.0  # kappa of that convex times its radius; of what was tried on two captures, this pair changes images little
KAPPA_RADIUS = 12.0  # initial kappa times radius: alpha falls from 95 % to 5 % of the opacity over half of the radius
NO_ATTRIBUTES: Mapping[str, Attribute] = {}


class Attribute(NamedTuple):
    """What each primitive carries for a motion, in addition to its shape and its colours. ``shape``: of one row. ``initial``: the value of
    all its numbers at which the primitive is at rest."""

    shape: tuple[int, ...] = ()
    initial: float = 0.0


class PrimitiveSet:
    """N primitives of one kind: named parameter tensors with N rows, and a flag for those that move.

    ``parameters`` maps each name of `FIELDS`, and then of what the motion needs (see `carrying`), to a leaf tensor [N, ...] float32;
    ``dynamic`` [N] bool: True for those that the motion moves.
    """

    KIND: ClassVar[str]
    FIELDS: ClassVar[tuple[str, ...]]

    def __init__(self, parameters: dict[str, Tensor], dynamic: Tensor | None = None) -> None:
        if tuple(parameters)[: len(self.FIELDS)] != self.FIELDS:
            raise ValueError(f"{self.KIND} need the fields {self.FIELDS} before others, got {tuple(parameters)}")
        rows = {name: p.shape[0] for name, p in parameters.items()}
        if len(set(rows.values())) != 1:
            raise ValueError(f"{self.KIND}: every field must have the same number of rows, got {rows}")
        self.parameters = {name: p.detach().float().contiguous().requires_grad_() for name, p in parameters.items()}
        count = len(self)
        self.dynamic = torch.ones(count, dtype=torch.bool, device=self.device) if dynamic is None else dynamic.bool().to(self.device)
        if self.dynamic.shape != (count,):
            raise ValueError(f"{self.KIND}: dynamic must be [{count}], got {list(self.dynamic.shape)}")

    def __len__(self) -> int:
        return next(iter(self.parameters.values())).shape[0]

    def __getattr__(self, name: str) -> Tensor:
        parameters = self.__dict__.get("parameters", {})
        if name in parameters:
            return parameters[name]
        raise AttributeError(name)

    @property
    def device(self) -> torch.device:
        return next(iter(self.parameters.values())).device

    def to(self, device: str | torch.device) -> Self:
        """The same set on ``device``; a copy if that is a different device."""
        return type(self)({name: p.detach().to(device) for name, p in self.parameters.items()}, self.dynamic)

    @property
    def opacities(self) -> Tensor:
        """[N] in (0, 1)."""
        return torch.sigmoid(self.opacity_logits)

    def carrying(self, attributes: Mapping[str, Attribute]) -> Self:
        """The same primitives, which carry these ``attributes`` and no others: those that were missing have their initial value. The set
        itself if it is one, else another one of the same tensors."""
        if self.parameters.keys() == {*self.FIELDS, *attributes}:
            return self
        kept = {name: self.parameters[name] for name in self.FIELDS}
        for name, (shape, initial) in attributes.items():
            known = self.parameters.get(name)
            kept[name] = torch.full((len(self), *shape), initial, device=self.device).requires_grad_() if known is None else known
        other = type(self)(kept, self.dynamic)
        other.parameters, other.dynamic = kept, self.dynamic
        return other

    def activated(self, logs: tuple[Tensor, ...], degree: int, light: Tensor | None = None) -> tuple[tuple[Tensor, ...], Tensor, Tensor]:
        """The exponentials of ``logs``, one or two float32 tensors of N rows; `opacities`; and the colours up to ``degree``: coefficients
        [N, (degree+1)^2, 3], or fewer if the set has no more. One kernel, on the CPU and on a GPU.

        Under ``light`` [C], the colour that all directions share is multiplied by 1 + shades . light, where the set carries the attribute
        `shades` [N, C]."""
        shown = min((degree + 1) ** 2 - 1, self.sh_rest.shape[1])
        given = logs, self.opacity_logits, self.sh_dc, self.sh_rest, shown, self.parameters.get("shades"), light
        if self.device.type == "cpu":
            return look(*given)
        from ..rasterizer.cuda.runtime import launcher_for
        from .cuda.looks import look as look_on_gpu

        return look_on_gpu(launcher_for(self.device), *given)

    def rest_points(self) -> Tensor:
        """[N * corners, 3] positions that the motion displaces."""
        raise NotImplementedError

    def select(self, index: Tensor) -> Self:
        """The rows ``index`` (long) as a new set."""
        return type(self)({name: p.detach().index_select(0, index) for name, p in self.parameters.items()}, self.dynamic[index])

    @classmethod
    def joined(cls, sets: Sequence[Self]) -> Self:
        """All rows of ``sets``, concatenated. All carry the same attributes."""
        parameters = {name: torch.cat([one.parameters[name].detach() for one in sets]) for name in sets[0].parameters}
        return cls(parameters, torch.cat([one.dynamic for one in sets]))

    def to_arrays(self) -> dict[str, np.ndarray]:
        """Arrays by name, prefixed with the kind: ``gaussians_means`` and so on."""
        arrays = {f"{self.KIND}_{name}": p.detach().cpu().numpy() for name, p in self.parameters.items()}
        arrays[f"{self.KIND}_dynamic"] = self.dynamic.cpu().numpy()
        return arrays

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, np.ndarray], attributes: Mapping[str, Attribute] = NO_ATTRIBUTES) -> Self:
        """Inverse of `to_arrays` for sets that carry ``attributes``. Those that are missing have their initial value, and arrays of others
        are not read."""
        names = [*cls.FIELDS, *(name for name in attributes if f"{cls.KIND}_{name}" in arrays)]
        stored = {name: torch.tensor(np.asarray(arrays[f"{cls.KIND}_{name}"])) for name in names}
        return cls(stored, torch.tensor(np.asarray(arrays[f"{cls.KIND}_dynamic"]))).carrying(attributes)


class GaussianSet(PrimitiveSet):
    """Eq. 2: means [N,3] world units, quats [N,4] w x y z of any norm, log_scales [N,3], opacity_logits [N], sh_dc [N,1,3],
    sh_rest [N,R,3]."""

    KIND = "gaussians"
    FIELDS = ("means", "quats", "log_scales", "opacity_logits", "sh_dc", "sh_rest")

    def rest_points(self) -> Tensor:
        return self.means

    @classmethod
    def from_points(
        cls, points: np.ndarray, colors: np.ndarray, sh_degree: int, opacity: float = 0.1, max_scale: float = np.inf
    ) -> GaussianSet:
        """Isotropic Gaussians at ``points`` [N,3] with ``colors`` [N,3] in [0,1]; scales from the three nearest neighbours."""
        from .fibonacci import neighbour_radius

        n = len(points)
        scales = np.clip(neighbour_radius(points), 1e-7, max_scale)
        quats = torch.zeros(n, 4)
        quats[:, 0] = 1
        return cls(
            {
                "means": torch.tensor(points),
                "quats": quats,
                "log_scales": torch.tensor(np.log(scales)).float()[:, None].repeat(1, 3),
                "opacity_logits": torch.full((n,), float(np.log(opacity / (1 - opacity)))),
                "sh_dc": torch.tensor((colors - 0.5) / SH_C0).float()[:, None],
                "sh_rest": torch.zeros(n, (sh_degree + 1) ** 2 - 1, 3),
            }
        )


class ConvexSet(PrimitiveSet):
    """Eq. 3: points [M,K,3] world units, log_tau and log_kappa [M] (1/world unit), opacity_logits [M], sh_dc [M,1,3], sh_rest [M,R,3]."""

    KIND = "convexes"
    FIELDS = ("points", "log_tau", "log_kappa", "opacity_logits", "sh_dc", "sh_rest")

    def rest_points(self) -> Tensor:
        return self.points.reshape(-1, 3)

    @classmethod
    def empty(cls, corners: int, sh_degree: int) -> ConvexSet:
        zero = torch.zeros(0)
        return cls(
            {
                "points": torch.zeros(0, corners, 3),
                "log_tau": zero,
                "log_kappa": zero,
                "opacity_logits": zero,
                "sh_dc": torch.zeros(0, 1, 3),
                "sh_rest": torch.zeros(0, (sh_degree + 1) ** 2 - 1, 3),
            }
        )

    @classmethod
    def from_points(cls, points: np.ndarray, colors: np.ndarray, sh_degree: int, opacity: float = 0.3) -> ConvexSet:
        """Convexes on ``points`` [M,K,3] with ``colors`` [M,3] in [0,1]; the width of each one's edges is in proportion to its size."""
        m = len(points)
        radius = np.linalg.norm(points - points.mean(axis=1, keepdims=True), axis=2).mean(axis=1).clip(min=1e-9)
        return cls(
            {
                "points": torch.tensor(points),
                "log_tau": torch.tensor(np.log(TAU_RADIUS / radius)),
                "log_kappa": torch.tensor(np.log(KAPPA_RADIUS / radius)),
                "opacity_logits": torch.full((m,), float(np.log(opacity / (1 - opacity)))),
                "sh_dc": torch.tensor((colors - 0.5) / SH_C0).float()[:, None],
                "sh_rest": torch.zeros(m, (sh_degree + 1) ** 2 - 1, 3),
            }
        )

    @classmethod
    def replacing(cls, gaussians: GaussianSet, corners: int) -> ConvexSet:
        """A convex in place of each of the M ``gaussians``, with its colours, opacity and attributes. Its ``corners`` points lie on a
        Fibonacci sphere that is stretched to `REACH` standard deviations of the Gaussian."""
        from .fibonacci import fibonacci_sphere

        g = gaussians.parameters
        with torch.no_grad():
            sphere = torch.tensor(fibonacci_sphere(corners), dtype=torch.float32, device=gaussians.device)
            scales = REACH * g["log_scales"].exp()
            points = g["means"][:, None] + (quats_to_matrices(g["quats"])[:, None] @ (scales[:, None] * sphere)[..., None])[..., 0]
            # A Gaussian of a surface is flat: what the image shows of it are its two larger axes.
            log_radius = scales.sort(1).values[:, 1:].log().mean(1)
            shape = {"points": points, "log_tau": math.log(TAU_RADIUS) - log_radius, "log_kappa": math.log(KAPPA_REACH) - log_radius}
            names = *cls.FIELDS, *(name for name in g if name not in gaussians.FIELDS)
            parameters = {name: (shape[name] if name in shape else g[name]).detach().clone() for name in names}
        return cls(parameters, gaussians.dynamic)
