"""The hulls of convexes as a triangle mesh. The outline of a hull is where its convex falls to half of its opacity."""

from __future__ import annotations

from itertools import combinations

import numpy as np

from ..rasterizer import Convexes
from .formats.ply import LEAST_ALPHA
from .mesh import Mesh
from .primitives import SH_C0

JITTER = 1e-6  # of a convex's extent: points are moved by this much, so that coplanar points give unique triangles


def hull_mesh(convexes: Convexes) -> Mesh:
    """The hulls of the visible ones among ``convexes`` (with sh), each with its mean colour and its opacity. Points inside a hull are left
    out."""
    assert convexes.sh is not None
    points = convexes.points.detach().cpu().double().numpy()
    opacities = convexes.opacities.detach().cpu().numpy()
    seen = (opacities >= LEAST_ALPHA) & np.isfinite(points).all((1, 2))
    points, corners = points[seen], points.shape[1]
    rgb = (0.5 + SH_C0 * convexes.sh[:, 0].detach().cpu().numpy()[seen]).clip(0, 1)
    colors = np.concatenate([rgb, opacities[seen, None].clip(0, 1)], axis=1).repeat(corners, axis=0)
    used, triangles = np.unique(hull_triangles(points), return_inverse=True)
    return Mesh(points.reshape(-1, 3)[used].astype(np.float32), colors[used].astype(np.float32), triangles.reshape(-1, 3).astype(np.int32))


def hull_triangles(points: np.ndarray) -> np.ndarray:
    """[F, 3]: triangles of the hulls of M sets of K >= 3 ``points`` [M, K, 3] float64, as row numbers of the points flattened to [M K, 3],
    counter-clockwise seen from outside. A set of three points gives one triangle."""
    count, corners = points.shape[:2]
    extent = np.ptp(points, axis=1).max(1, initial=0)[:, None, None]
    moved = points - points.mean(1, keepdims=True) + JITTER * extent * np.random.default_rng(0).uniform(-1, 1, (corners, 3))
    triples = np.array(list(combinations(range(corners), 3)))
    a, b, c = (moved[:, triples[:, k]] for k in range(3))  # [M, T, 3]
    normal = np.cross(b - a, c - a)
    height = normal @ moved.transpose(0, 2, 1) - np.einsum("mtd,mtd->mt", normal, a)[:, :, None]  # of each point over each triangle
    for k in range(3):
        height[:, np.arange(len(triples)), triples[:, k]] = 0  # its own corners
    outward, inward = (height <= 0).all(2), (height >= 0).all(2)
    first = corners * np.arange(count)[:, None, None]
    faces, turned = first + triples, first + triples[:, [0, 2, 1]]
    return np.concatenate([faces[outward], turned[inward & ~outward]])
