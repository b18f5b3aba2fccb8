"""What goes into `rasterize` and what comes out: plain dataclasses of tensors, without behaviour."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor

# In the order in which backends hand them to autograd.
GAUSSIAN_FIELDS = ("means", "quats", "scales", "opacities", "sh", "colors", "extras")
CONVEX_FIELDS = ("points", "tau", "kappa", "opacities", "sh", "colors", "extras")
IMAGES = ("color", "alpha", "depth", "extras")


@dataclass(eq=False)
class Camera:
    """A pinhole camera in OpenCV convention (x right, y down, z forward), pixel centres at +0.5.

    K: [3, 3] float, pixels. Only fx, fy, cx, cy are read; skew is refused.
    cam_from_world: [4, 4] float, the rigid transform from world to camera coordinates. Only its first three rows are read.
    width, height: pixels.
    near: world units along z; Gaussians whose centre, and convexes of which any point, has z < near are culled.

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
    quats: [N, 4] float, order w x y z, any norm but zero; the rotation is that of quats / |quats|.
    scales: [N, 3] float > 0, standard deviations along the rotated axes, world units.
    opacities: [N] float in [0, 1].
    sh: [N, (L+1)^2, 3] float, L = 0..3, 3DGS basis and signs; colour = max(0, basis . sh + 0.5).
    colors: [N, 3] float, blended as they are (not clamped).
    extras: [N, E] float, further channels blended with the colour's weights; None counts as zeros.
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

    points: [M, K, 3] float, K = 3..8 free points, world units; the convex is drawn from the hull of their projections.
    tau: [M] float > 0, sharpness of the smooth maximum over edges (Eq. 5), 1 / world unit.
    kappa: [M] float > 0, sharpness of the boundary (Eq. 6), 1 / world unit.
    opacities: [M] float in [0, 1].
    sh, colors, extras: as in `Gaussians`; the direction for SH goes to the centroid of all K points.
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

    color: [H, W, 3], background included.
    alpha: [H, W], 1 - transmittance.
    depth: [H, W], alpha-weighted mean z of centres and centroids, world units; 0 where alpha is 0.
    extras: [H, W, E], E = 0 where no kind has extras.
    visible_gaussians: [N] bool, visible_convexes: [M] bool; True for every primitive that some pixel blends
        (and possibly for others that meet the image).
    """

    color: Tensor
    alpha: Tensor
    depth: Tensor
    extras: Tensor
    visible_gaussians: Tensor
    visible_convexes: Tensor
