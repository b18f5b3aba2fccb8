"""A Gaussian for each convex, for tools that do not support convexes: in the frame of the convex's points, so that it moves with them."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import permutations, product

import torch
from torch import Tensor

from ..rasterizer import Convexes, Gaussians

THINNEST = 1e-3  # of a convex's longest axis; a flat convex would have no frame without this minimum


@dataclass
class GaussianFit:
    """How M convexes become Gaussians. Each convex has a frame: the principal axes of its points at rest, scaled by the points' standard
    deviations.

    reference [M, K, 3]: the points at rest. log_spread [M, 3]: ln of the Gaussian's standard deviations along the axes, in units of the
    points'. offset [M, 3]: its mean in this frame, relative to the mean of the points. opacity [M]: added to the logit of the opacity.
    """

    reference: Tensor
    log_spread: Tensor
    offset: Tensor
    opacity: Tensor

    @classmethod
    def uniform(cls, reference: Tensor, spread: float) -> GaussianFit:
        """Make every standard deviation ``spread`` times that of the points."""
        none = reference.new_zeros(len(reference), 3)
        return cls(reference.detach(), none + float(torch.tensor(spread).log()), none.clone(), none[:, 0].clone())

    def gaussians(self, convexes: Convexes) -> Gaussians:
        """The Gaussians for ``convexes`` (with sh), which are those of ``reference`` after some motion.

        Differentiable with respect to this fit, except for the rotation of the axes that an uneven spread causes in a sheared convex."""
        assert convexes.sh is not None
        points = convexes.points.detach()
        frame = frames(points, self.reference)
        wide = frame * self.log_spread.exp()[:, None]
        covariance = wide @ wide.transpose(1, 2)
        with torch.no_grad():
            _, axes = torch.linalg.eigh(covariance)
            axes = named_as(axes, wide)
        scales = (axes * (covariance @ axes)).sum(1).clamp(min=1e-14).sqrt()
        means = points.mean(1) + (frame @ self.offset[:, :, None])[..., 0]
        opacities = torch.sigmoid(torch.logit(convexes.opacities.detach(), eps=1e-6) + self.opacity)
        # A convex that is absent at this time stays absent, whatever the fit adds.
        opacities = torch.where(convexes.opacities.detach() > 0, opacities, 0.0)
        return Gaussians(means, _quats(axes), scales, opacities, sh=convexes.sh.detach())


@torch.no_grad()
def named_as(axes: Tensor, frame: Tensor) -> Tensor:
    """``axes`` [M, 3, 3], orthonormal columns, in the order and with the signs that make them the rotation nearest to that of ``frame``
    [M, 3, 3]. A solver sorts axes anew at each time, so they would swap or flip between times, and what lies between would turn with them;
    a frame that turns with the points does not."""
    turned = frame.double().clone()
    turned[:, :, 2] *= torch.where(torch.linalg.det(turned) < 0, -1.0, 1.0)[:, None]
    u, _, vt = torch.linalg.svd(turned)
    names = torch.tensor(
        [
            [[sign[i] * (order[i] == j) for i in range(3)] for j in range(3)]
            for order in permutations(range(3))
            for sign in product((1.0, -1.0), repeat=3)
        ],
        dtype=torch.float64,
        device=frame.device,
    )
    likeness = torch.einsum("nji,mji->mn", names, axes.double().transpose(1, 2) @ (u @ vt))
    right = torch.linalg.det(names)[None] * torch.linalg.det(axes.double())[:, None] > 0
    return axes @ names.to(axes)[torch.where(right, likeness, -torch.inf).argmax(1)]


@torch.no_grad()
def frames(points: Tensor, reference: Tensor) -> Tensor:
    """[M, 3, 3] F, where F F^T is the covariance of ``points`` [M, K, 3] and F turns with the points. If an affine map A takes
    ``reference`` to them, F is A times the scaled principal axes of ``reference``; otherwise it is the nearest such frame."""
    now, rest = (p.double() - p.double().mean(1, keepdim=True) for p in (points, reference))
    root, inverse = _root(now)
    values, axes = _spectrum(rest)
    white, white_rest = now @ inverse, rest @ (axes / values[:, None].sqrt())
    u, _, vt = torch.linalg.svd(white.transpose(1, 2) @ white_rest)
    return (root @ u @ vt).to(points)


def _spectrum(centred: Tensor) -> tuple[Tensor, Tensor]:
    """Eigenvalues [M, 3], kept away from 0, and axes [M, 3, 3] of the covariance of ``centred`` [M, K, 3]."""
    values, axes = torch.linalg.eigh(centred.transpose(1, 2) @ centred / centred.shape[1])
    return values.clamp(min=1e-30).maximum(THINNEST**2 * values[:, 2:]), axes


def _root(centred: Tensor) -> tuple[Tensor, Tensor]:
    """The symmetric square root of the covariance and its inverse, [M, 3, 3] each."""
    values, axes = _spectrum(centred)
    scaled = axes * values.sqrt()[:, None], axes / values.sqrt()[:, None]
    return scaled[0] @ axes.transpose(1, 2), scaled[1] @ axes.transpose(1, 2)


def _quats(matrices: Tensor) -> Tensor:
    """[M, 4] w x y z of rotations [M, 3, 3]."""
    from scipy.spatial.transform import Rotation

    if not len(matrices):
        return matrices.new_zeros(0, 4)
    xyzw = Rotation.from_matrix(matrices.cpu().double().numpy()).as_quat()
    return torch.from_numpy(xyzw[:, [3, 0, 1, 2]]).to(matrices)
