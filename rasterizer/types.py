"""The inputs and outputs of `rasterize`: plain dataclasses of tensors, without behaviour."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor

# In the order in which the backends pass them to autograd.
GAUSSIAN_FIELDS = ("means", "quats", "scales", "opacities", "sh", "colors", "extras")
CONVEX_FIELDS = ("points", "tau", "kappa", "opacities", "sh", "colors", "extras")
IMAGES = ("color", "alpha", "depth", "extras")

TILE = 16  # px, side of the squares that `rasterize` can leave out; kTile in records.h and device.cuh


@dataclass(eq=False)
class Camera:
    """A pinhole camera in the OpenCV convention (x right, y down, z forward), with pixel centres at +0.5.

    K: [3, 3] float, pixels. Only fx, fy, cx, cy are used; skew is rejected.
    cam_from_world: [4, 4] float, the rigid transform from world to camera coordinates. Only its first three rows are used.
    width, height: pixels.
    near: world units along z. A Gaussian is culled if its centre has z < near, a convex if any of its points does (in the antialiased
        mode, if all of them do).

    K and cam_from_world may carry gradients. The camera's centre is -R^T t.
    """

    K: Tensor
    cam_from_world: Tensor
    width: int
    height: int
    near: float = 0.01


@dataclass(eq=False)
class Gaussians:
    """N anisotropic 3D Gaussians in world coordinates. Exactly one of `sh` and `colors` is given.

    means: [N, 3] float, world units.
    quats: [N, 4] float, order w x y z, any non-zero norm; the rotation is given by quats / |quats|.
    scales: [N, 3] float > 0, standard deviations along the rotated axes, world units.
    opacities: [N] float in [0, 1].
    sh: [N, (L+1)^2, 3] float, L = 0..3, 3DGS basis and signs; colour = max(0, basis . sh + 0.5).
    colors: [N, 3] float, blended as they are (not clamped).
    extras: [N, E] float, additional channels, blended with the same weights as the colour; None counts as zeros.
    """

    means: Tensor
    quats: Tensor
    scales: Tensor
    opacities: Tensor
    sh: Tensor | None = None
    colors: Tensor | None = None
    extras: Tensor | None = None


@dataclass(eq=False)
class Convexes:
    """M smooth convexes in world coordinates (Edge4DGS, Eq. 3-7). Exactly one of `sh` and `colors` is given.

    points: [M, K, 3] float, K = 3..8 free points, world units; the hull of their projections defines the convex in the image.
    tau: [M] float > 0, sharpness of the smooth maximum over edges (Eq. 5), 1 / world unit.
    kappa: [M] float > 0, sharpness of the boundary (Eq. 6), 1 / world unit.
    opacities: [M] float in [0, 1].
    sh, colors, extras: as in `Gaussians`; SH are evaluated in the direction to the centroid of all K points.
    """

    points: Tensor
    tau: Tensor
    kappa: Tensor
    opacities: Tensor
    sh: Tensor | None = None
    colors: Tensor | None = None
    extras: Tensor | None = None


@dataclass(eq=False)
class Frame:
    """One rendered view. float32 from the `cpu` and `cuda` backends, float64 from `reference`.

    color: [H, W, 3], including the background.
    alpha: [H, W], 1 - transmittance.
    depth: [H, W], alpha-weighted mean z of centres and centroids, world units; 0 where alpha is 0.
    extras: [H, W, E]; E = 0 if neither kind has extras.
    visible_gaussians: [N] bool, visible_convexes: [M] bool; True for every primitive that contributes to some pixel
        (and possibly for others that overlap the image).
    """

    color: Tensor
    alpha: Tensor
    depth: Tensor
    extras: Tensor
    visible_gaussians: Tensor
    visible_convexes: Tensor
