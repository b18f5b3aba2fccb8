"""Smooth convexes: from K free points to the alpha at a pixel (Edge4DGS, Eq. 3-7)."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from ..types import Camera, Convexes
from ..validate import usable
from .antialias import clip_points, fade, footprint, keep_off_camera
from .hull import extent, hull_area, hull_corners
from .sh import colors_of

DEGENERATE = 1e-5  # a convex is culled unless the area of its hull is above this fraction of the hull's squared extent


@dataclass(eq=False)
class Shapes:
    """The m convexes that survive culling, in input order. A convex has up to K edges; the rest of its row is padding."""

    index: Tensor  # [m] int64, indices in the input
    depths: Tensor  # [m] z of the centroid in camera coordinates
    normals: Tensor  # [m, K, 3] unit outward normals of the planes through the camera's centre and an edge
    log_weights: Tensor  # [m, K] ln w_i; -inf where there is no edge
    tau: Tensor  # [m]
    kappa: Tensor  # [m]
    opacities: Tensor  # [m]
    colors: Tensor  # [m, 3]
    extras: Tensor  # [m, E]


def project_convexes(camera: Camera, convexes: Convexes, antialiased: bool = False) -> Shapes:
    """Cull convexes (bad values, any point nearer than `near`, degenerate hull) and compute the outlines of the rest.

    In the antialiased mode, points nearer than `near` are clipped; only a convex without any point in front is culled.
    """
    rotation, translation = camera.cam_from_world[:3, :3], camera.cam_from_world[:3, 3]
    with torch.no_grad():
        z = (convexes.points @ rotation.T + translation)[..., 2]
        seen = (z > camera.near).any(1) if antialiased else (z >= camera.near).all(1)
        index = (usable(convexes) & seen).nonzero()[:, 0]

    # From here on, only survivors: a culled primitive is not part of the autograd graph, so its gradient is zero, never NaN.
    points = convexes.points[index] @ rotation.T + translation
    if antialiased:
        points = clip_points(points, camera.near)
    plane = points[..., :2] / points[..., 2:]  # (x/z, y/z)
    starts, ends, is_edge, kept = silhouettes(plane.detach())
    index, points, plane = index[kept], points[kept], plane[kept]
    a = torch.gather(plane, 1, starts[..., None].expand(-1, -1, 2))
    b = torch.gather(plane, 1, ends[..., None].expand(-1, -1, 2))

    # The normal of the plane through the camera's centre and both corners is b x a. It points outward because the corners are in
    # the order with a positive shoelace sum. Normalising removes any positive factor, so we use z = 1 and an edge of unit length,
    # (b - a) / l = e. Then b x a = (e_y, -e_x, a_y e_x - a_x e_y), whose length is at least 1 however short the edge is.
    lengths = torch.hypot(b[..., 0] - a[..., 0], b[..., 1] - a[..., 1])
    edge = (b - a) / lengths[..., None]
    normals = torch.stack([edge[..., 1], -edge[..., 0], a[..., 1] * edge[..., 0] - a[..., 0] * edge[..., 1]], -1)
    normals = normals / normals.norm(dim=-1, keepdim=True)

    # w_i = K l_i / sum(l) keeps alpha continuous when a point enters or leaves the hull.
    perimeter = (lengths * is_edge).sum(1, keepdim=True)
    depths, kappa, opacities = points[..., 2].mean(1), convexes.kappa[index], convexes.opacities[index]
    centroids = convexes.points[index].mean(1)
    if antialiased:
        # Padding repeats the first edge; relative to its start, its triangle has no area.
        p, q = a - a[:, :1], b - a[:, :1]
        area = 0.5 * (p[..., 0] * q[..., 1] - p[..., 1] * q[..., 0]).sum(1)
        kappa, share = footprint(kappa, area, perimeter[:, 0], depths, torch.sqrt(camera.K[0, 0] * camera.K[1, 1]))
        opacities = opacities * share * fade(depths, camera.near)
        centroids = keep_off_camera(centroids, camera)
    log_weights = torch.log(lengths.shape[1] * lengths / perimeter).masked_fill(~is_edge, -torch.inf)
    assert convexes.extras is not None  # rasterize() has padded them
    return Shapes(
        index=index,
        depths=depths,
        normals=normals,
        log_weights=log_weights,
        tau=convexes.tau[index],
        kappa=kappa,
        opacities=opacities,
        colors=colors_of(convexes, index, centroids, camera),
        extras=convexes.extras[index],
    )


def silhouettes(plane: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """The hulls of points [n, K, 2] in the plane (x/z, y/z), without degenerate ones.

    Returns starts, ends [m, K] int64 (the two points of each edge, in the order with a positive shoelace sum), is_edge [m, K] bool, and
    kept [m] int64, the rows of `plane` that are not degenerate. Padding repeats the first edge, so that unused entries stay finite and
    in range.
    """
    starts, ends, is_edge, kept = [], [], [], []
    count = plane.shape[1]
    for row, points in enumerate(plane.tolist()):
        points = [(x, y) for x, y in points]
        corners = hull_corners(points)
        if is_degenerate(points, corners):
            continue
        padding = count - len(corners)
        starts.append(corners + corners[:1] * padding)
        ends.append(corners[1:] + corners[:1] + corners[1:2] * padding)
        is_edge.append([True] * len(corners) + [False] * padding)
        kept.append(row)
    edges = [torch.tensor(x, device=plane.device).reshape(-1, count) for x in (starts, ends, is_edge)]
    return edges[0].long(), edges[1].long(), edges[2].bool(), torch.tensor(kept, dtype=torch.int64, device=plane.device)


def is_degenerate(points: list[tuple[float, float]], corners: list[int]) -> bool:
    """Whether the hull is a point, a line or a sliver: its area is at most 1e-5 of the squared longer side of the bounding box."""
    return not hull_area(points, corners) > DEGENERATE * extent(points) ** 2


def convex_alphas(shapes: Shapes, camera: Camera, pixels: Tensor) -> Tensor:
    """[P, m] o M at pixels [P, 2], before the cap and the cutoff.

    d is the pixel's ray with d.z = 1, and p = z_c d, where z_c is the z of the centroid. H_i = u_i . p (Eq. 4, world units),
    S = (1/tau) ln sum_i w_i exp(tau H_i) (Eq. 5), M = 1 / (1 + exp(kappa S)) (Eq. 6).
    """
    fx, fy, cx, cy = camera.K[0, 0], camera.K[1, 1], camera.K[0, 2], camera.K[1, 2]
    rays = torch.stack([(pixels[:, 0] - cx) / fx, (pixels[:, 1] - cy) / fy, torch.ones_like(pixels[:, 0])], -1)
    distances = torch.einsum("mkc,pc->pmk", shapes.normals, rays) * shapes.depths[:, None]  # H_i
    smooth = torch.logsumexp(shapes.log_weights + shapes.tau[:, None] * distances, -1) / shapes.tau  # S
    return shapes.opacities * torch.sigmoid(-shapes.kappa * smooth)
