"""How far measured flow is from what camera motion alone would cause: the reprojection error of the best static point for every pixel."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

NEAREST = 10.0  # times the median inverse depth; a static point nearer than a tenth of the median depth is not plausible
ITERATIONS = 3  # of reweighting by depth; the cross-multiplied equations are linear, and their weights settle in two
INVISIBLE = 1e-3  # of the depth without baseline; a point nearer to the second camera than this counts as behind it


@dataclass(frozen=True)
class Neighbour:
    """Flow of a frame to another frame of the same camera, and where that camera then was.

    flow [H, W, 2] float32 px (u right, v down; values that are not finite count as unknown). confidence [H, W] uint8, 255 = forward and
    backward flow agree (`flow.two_way.consistency`). K [3, 3] px with pixel centres at +0.5 and cam_from_world [4, 4] (OpenCV) of the
    other frame, or None for both.
    """

    flow: np.ndarray
    confidence: np.ndarray
    K: np.ndarray | None = None
    cam_from_world: np.ndarray | None = None


@dataclass(frozen=True)
class Residual:
    """error [H, W] float32 px: root mean square over neighbours of flow minus camera motion; 0 where unknown.

    weight [H, W] float32 in [0, 1]: mean confidence of the neighbours it is based on; 0 = unknown.
    """

    error: np.ndarray
    weight: np.ndarray


def checked(neighbours: Sequence[Neighbour]) -> tuple[int, int]:
    """(H, W) of the neighbours. Raises ValueError if there are none or their shapes differ."""
    if not neighbours:
        raise ValueError("neighbours: expected at least one")
    height, width = neighbours[0].confidence.shape[:2]
    for k, one in enumerate(neighbours):
        if one.flow.shape != (height, width, 2) or one.confidence.shape != (height, width) or one.confidence.dtype != np.uint8:
            raise ValueError(
                f"neighbours[{k}]: expected flow [{height}, {width}, 2] and confidence uint8 [{height}, {width}], got "
                f"{list(one.flow.shape)} and {one.confidence.dtype} {list(one.confidence.shape)}"
            )
    return height, width


def known(neighbour: Neighbour) -> tuple[np.ndarray, np.ndarray]:
    """Flow [H, W, 2] float32 and weight [H, W] float32 in [0, 1], both 0 where the flow is not finite."""
    flow = np.asarray(neighbour.flow, np.float32)
    weight = neighbour.confidence.astype(np.float32) * np.float32(1 / 255)
    broken = ~np.isfinite(flow[..., 0] + flow[..., 1])  # ten times as fast as all(-1)
    if broken.any():
        flow = np.where(broken[..., None], np.float32(0), flow)
        weight[broken] = 0
    return flow, weight


def rigid_residual(K: np.ndarray, cam_from_world: np.ndarray, neighbours: Sequence[Neighbour]) -> Residual:
    """Reprojection error of the static point on each pixel's ray that best fits the flow to all neighbours.

    K [3, 3] px, cam_from_world [4, 4] of the frame itself. A static point of inverse depth r on the ray of x appears in another frame at
    x' ~ H x + r e, where H = K' R K^-1 is the homography of the plane at infinity and e = K' t the epipole (Hartley and Zisserman, eq.
    9.7). Cross-multiplied, both coordinates of x' are linear in r, so least squares gives r in closed form. The equations are weighted
    with confidence and, over a few rounds, with the depth that turns the algebraic error into the geometric one.

    Why not the Sampson distance of each pair: with one neighbour this error is the distance to the epipolar line, and with two or more it
    also sees motion along the line, because the depths disagree. Without baseline e is 0 and r drops out, which leaves the error of the
    rotation's homography, with no switch between models. r is kept at or above 0 (in front of the camera) and at or below `NEAREST` times
    the picture's median, so that noise over a tiny baseline cannot explain motion by an absurd depth. Motion that follows one static
    point's path in all frames at once is not seen, for example an object that follows the camera at constant speed.

    Raises ValueError for neighbours without poses or of other shapes, and for poses that are not finite.
    """
    checked(neighbours)
    terms, unit = [], 0.0
    for k, one in enumerate(neighbours):
        if one.K is None or one.cam_from_world is None:
            raise ValueError(f"neighbours[{k}]: K and cam_from_world are needed; without poses use uncalibrated_residual")
        relative = np.asarray(one.cam_from_world, np.float64) @ np.linalg.inv(np.asarray(cam_from_world, np.float64))
        homography = np.asarray(one.K, np.float64) @ relative[:3, :3] @ np.linalg.inv(np.asarray(K, np.float64))
        epipole = np.asarray(one.K, np.float64) @ relative[:3, 3]
        if not (np.isfinite(homography).all() and np.isfinite(epipole).all()):
            raise ValueError(f"neighbours[{k}]: expected finite K and cam_from_world; leave frames without a pose out")
        terms.append((homography, epipole))
        unit = max(unit, float(np.abs(epipole).max()))
    # world units cancel; float32 stays far from its limits
    return static_point_residual([(h, e / (unit or 1.0)) for h, e in terms], neighbours, bounded=True)


def static_point_residual(views: Sequence[tuple[np.ndarray, np.ndarray]], neighbours: Sequence[Neighbour], bounded: bool) -> Residual:
    """`rigid_residual` for views (H [3, 3], e [3]) with x' ~ H x + r e. bounded: r is an inverse depth; else of any sign (projective)."""
    height, width = checked(neighbours)
    x = (np.arange(width) + 0.5).astype(np.float32)
    y = (np.arange(height) + 0.5).astype(np.float32)[:, None]
    equations = []
    total = np.zeros((height, width), np.float32)
    for one, (homography, epipole) in zip(neighbours, views):
        flow, weight = known(one)
        h, e = homography.astype(np.float32), epipole.astype(np.float32)
        hx, hy, hz = (h[c, 0] * x + (h[c, 1] * y + h[c, 2]) for c in range(3))
        u, v = x + flow[..., 0], y + flow[..., 1]
        equations.append((u * e[2] - e[0], v * e[2] - e[1], hx - u * hz, hy - v * hz, hz, e[2], weight))
        total += weight
    r = np.zeros((height, width), np.float32)
    for _ in range(ITERATIONS):
        above, below = np.zeros_like(r), np.full_like(r, 1e-20)
        for au, av, bu, bv, hz, ez, weight in equations:
            w = weight / np.square(np.maximum(hz + r * ez, INVISIBLE))
            above += w * (au * bu + av * bv)
            below += w * (au * au + av * av)
        r = above / below
        if bounded:
            np.maximum(r, 0, out=r)
            sure = r[total > 0.25 * len(neighbours)]
            if sure.size:
                np.minimum(r, NEAREST * np.median(sure), out=r)
    error = np.zeros_like(r)
    for au, av, bu, bv, hz, ez, weight in equations:
        w = weight / np.square(np.maximum(hz + r * ez, INVISIBLE))
        error += w * (np.square(bu - r * au) + np.square(bv - r * av))
    error = np.sqrt(error / np.maximum(total, 1e-6))
    return Residual(error, total * np.float32(1 / len(neighbours)))
