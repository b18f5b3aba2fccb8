"""`Bundle`: bundle adjustment of cameras that mostly turn, with the directions of the points and, if wanted, their distances.

A point is a direction d from the world's origin and an inverse distance rho; a camera (R, t) sees it along R d + rho t. A point at
infinity is simply rho = 0, while in world coordinates it would diverge. This is the parametrisation of Yu and Gallup, "3D Reconstruction
from Accidental Motion" (CVPR 2014), but directions are adjusted too. Solved by Levenberg-Marquardt with the points eliminated first (Schur
complement) and Cauchy's loss as weights.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise, product
from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import as_strided
from scipy.sparse import csr_array

from ....pipeline import thread_count

CAUCHY = 2.385 / 1.1774  # width of the loss, times the median error of a Gaussian in two dimensions
FINEST = 0.01  # px
SETTLED = 1e-4  # relative change of the cost
STEPS = 25
STRONGEST = 0.5  # largest radial term
GROUP = 128  # points eliminated together: few of the frames of a long pan see them
PARTS = 4  # of the groups, eliminated beside one another; a fixed number, so that the result does not depend on the threads


@dataclass(frozen=True)
class Bundle:
    """R [F, 3, 3], t [F, 3]: cam from world; d [P, 3] unit directions, rho [P] inverse distances; focal px, k1 (COLMAP's SIMPLE_RADIAL),
    centre [2] px. In observation o, frame `frame[o]` sees point `point[o]` at `xy[o]` px; xy is [O, 2]. They are sorted by point, and no
    frame sees a point twice. Points are best sorted by their first frame."""

    R: np.ndarray
    t: np.ndarray
    d: np.ndarray
    rho: np.ndarray
    focal: float
    k1: float
    centre: np.ndarray
    frame: np.ndarray
    point: np.ndarray
    xy: np.ndarray

    def local(self) -> np.ndarray:
        """[O, 3]: R d + rho t for every observation."""
        turned = np.einsum("oij,oj->oi", self.R[self.frame], self.d[self.point])
        return np.asarray(turned + self.rho[self.point, None] * self.t[self.frame])

    def errors(self) -> np.ndarray:
        """[O] px; inf where the point is not in front of the camera."""
        local = self.local()
        with np.errstate(all="ignore"):
            u = local[:, :2] / local[:, 2:]
            seen = self.focal * u * (1 + self.k1 * (u**2).sum(axis=1, keepdims=True)) + self.centre
            error = np.linalg.norm(seen - self.xy, axis=1)
        return np.where((local[:, 2] > 0) & np.isfinite(error), error, np.inf)


def solve(bundle: Bundle, move: bool, lens: int, tick: Callable[[], None] = lambda: None) -> Bundle:
    """The adjusted bundle. Rotations and directions are always adjusted; `move` adds translations and distances; `lens` 1 adds the focal
    length, and 2 also k1. tick: called before each of at most `STEPS` steps."""
    damping = 1e-3
    errors = bundle.errors()
    scale = max(FINEST, CAUCHY * float(np.median(errors)))
    cost = _cost(errors, scale)
    for _ in range(STEPS):
        tick()
        system = _normal(bundle, scale, move, lens)
        for tries in range(8):
            trial = _step(bundle, system, damping, move, lens)
            errors = trial.errors()
            now = _cost(errors, scale)
            if np.isfinite(now) and now < cost:
                settled = cost - now < SETTLED * cost
                bundle = trial
                if not tries:  # what has just been refused would be refused again
                    damping = max(1e-9, damping / 5)
                scale = max(FINEST, CAUCHY * float(np.median(errors)))
                cost = _cost(errors, scale)
                break
            damping *= 5
        else:
            return bundle
        if settled:
            return bundle
    return bundle


def _cost(errors: np.ndarray, scale: float) -> float:
    seen = np.minimum(errors, 1e6)
    return float(np.log1p((seen / scale) ** 2).mean() * scale**2)


class Group(NamedTuple):
    """m points that are eliminated together. columns [c]: the unknowns of the cameras that see them; W [m, k, c]: how both are coupled."""

    points: slice
    columns: np.ndarray
    W: np.ndarray


class System(NamedTuple):
    """Normal equations: camera block A [C, C] and right side a [C], point blocks V [P, k, k] and v [P, k], and the coupling by groups."""

    A: np.ndarray
    a: np.ndarray
    V: np.ndarray
    v: np.ndarray
    groups: list[Group]


def _normal(bundle: Bundle, scale: float, move: bool, lens: int) -> System:
    frames, points, k = len(bundle.R), len(bundle.d), 3 if move else 2
    residual, J_camera, J_point, J_lens = _jacobians(bundle, move, lens)
    weight = 1 / (1 + (residual**2).sum(axis=1) / scale**2)
    per = J_camera.shape[2]
    wJ, wP = weight[:, None, None] * J_camera, weight[:, None, None] * J_point
    size = per * frames + lens
    A, a = np.zeros((size, size)), np.zeros(size)
    blocks = _summed(_products(wJ, J_camera), bundle.frame, frames)
    lens_blocks = _summed(_products(wJ, J_lens), bundle.frame, frames)
    a[: per * frames] = _summed(_products(wJ, residual[:, :, None]), bundle.frame, frames).reshape(-1)
    for i in range(frames):
        at = slice(per * i, per * (i + 1))
        A[at, at] = blocks[i]
        A[at, per * frames :], A[per * frames :, at] = lens_blocks[i], lens_blocks[i].T
    A[per * frames :, per * frames :] = np.einsum("o,oij,oik->jk", weight, J_lens, J_lens)
    a[per * frames :] = np.einsum("o,oij,oi->j", weight, J_lens, residual)
    V = _summed(_products(wP, J_point), bundle.point, points)
    v = _summed(_products(wP, residual[:, :, None]), bundle.point, points)[:, :, 0]
    joined, lens_joined = _products(wP, J_camera), _summed(_products(wP, J_lens), bundle.point, points)
    groups = []
    for first in range(0, points, GROUP):
        last = min(first + GROUP, points)
        start, end = np.searchsorted(bundle.point, [first, last])
        seeing, place = np.unique(bundle.frame[start:end], return_inverse=True)
        W = np.zeros((last - first, k, per * len(seeing) + lens))
        by_frame = as_strided(W, (last - first, len(seeing), k, per), (W.strides[0], per * W.itemsize, W.strides[1], W.itemsize))
        by_frame[bundle.point[start:end] - first, place] = joined[start:end]
        W[:, :, per * len(seeing) :] = lens_joined[first:last]
        own = (per * seeing[:, None] + np.arange(per)).reshape(-1)
        groups.append(Group(slice(first, last), np.concatenate([own, np.arange(size - lens, size)]), W))
    return System(A, a, V, v, groups)


def _jacobians(bundle: Bundle, move: bool, lens: int) -> tuple[np.ndarray, ...]:
    """Residuals [O, 2] px, and their derivatives by camera [O, 2, 3 or 6], point [O, 2, 2 or 3] and lens [O, 2, lens]."""
    turned = np.einsum("oij,oj->oi", bundle.R[bundle.frame], bundle.d[bundle.point])
    local = turned + bundle.rho[bundle.point, None] * bundle.t[bundle.frame]
    z = np.where(local[:, 2] > 1e-6, local[:, 2], np.inf)
    u = local[:, :2] / z[:, None]
    r2 = (u**2).sum(axis=1)
    bent = u * (1 + bundle.k1 * r2)[:, None]
    residual = np.where(np.isfinite(z)[:, None], bundle.focal * bent + bundle.centre - bundle.xy, 0.0)
    to_u = np.zeros((len(z), 2, 3))
    to_u[:, 0, 0] = to_u[:, 1, 1] = 1 / z
    to_u[:, :, 2] = -u / z[:, None]
    bend = (1 + bundle.k1 * r2)[:, None, None] * np.eye(2) + 2 * bundle.k1 * u[:, :, None] * u[:, None, :]
    G = bundle.focal * bend @ to_u
    J_camera = -G @ _cross(turned)
    J_point = G @ (bundle.R[bundle.frame] @ _tangents(bundle.d)[bundle.point])
    if move:
        J_camera = np.concatenate([J_camera, G * bundle.rho[bundle.point, None, None]], axis=2)
        J_point = np.concatenate([J_point, G @ bundle.t[bundle.frame][:, :, None]], axis=2)
    J_lens = np.stack([bundle.focal * bent, bundle.focal * u * r2[:, None]], axis=2)[:, :, :lens]
    return residual, J_camera, J_point, J_lens


def _products(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """[O, j, k]: of every observation, a^T b, from [O, 2, j] and [O, 2, k]."""
    return np.asarray(a.transpose(0, 2, 1) @ b)


def _summed(values: np.ndarray, index: np.ndarray, count: int) -> np.ndarray:
    """[count, ...]: the sums of the rows of ``values`` [O, ...] that have one ``index`` [O]."""
    one = csr_array((np.ones(len(index)), index, np.arange(len(index) + 1)), shape=(len(index), count))
    return np.asarray(one.T @ values.reshape(len(index), -1)).reshape(count, *values.shape[1:])


def _step(bundle: Bundle, system: System, damping: float, move: bool, lens: int) -> Bundle:
    A, a, V, v, groups = system
    frames, per = len(bundle.R), 6 if move else 3
    # a floor under the diagonal keeps unmeasured quantities (the world's rotation, scale and origin; distances under no angle) in place
    S = A + np.diag(damping * np.diag(A) + 1e-9 * np.trace(A) / len(A))
    s = a.copy()
    try:
        root = np.linalg.inv(np.linalg.cholesky(V + _diagonal(V, damping)))  # root^T root is the inverse
        side = root @ v[:, :, None]
        carried: list[np.ndarray] = []
        with ThreadPoolExecutor(min(PARTS, thread_count())) as pool:
            for some, square, cross in pool.map(partial(_eliminated, root=root, side=side, size=len(S)), _parts(groups)):
                carried += some
                S -= square
                s -= cross
        dx = -np.linalg.solve(S, s)
    except np.linalg.LinAlgError:
        return bundle
    for group, of in zip(groups, carried, strict=True):
        side[group.points, :, 0] += of @ dx[group.columns]
    dp = -(root.transpose(0, 2, 1) @ side)[:, :, 0]
    cameras = dx[: per * frames].reshape(frames, per)
    R = rotations(cameras[:, :3]) @ bundle.R
    d = bundle.d + np.einsum("pij,pj->pi", _tangents(bundle.d), dp[:, :2])
    changed = replace(bundle, R=R, d=d / np.linalg.norm(d, axis=1, keepdims=True))
    if move:
        changed = replace(changed, t=bundle.t + cameras[:, 3:], rho=bundle.rho + dp[:, 2])
    if lens:
        changed = replace(changed, focal=bundle.focal * float(np.exp(np.clip(dx[-lens], -0.3, 0.3))))
    if lens == 2:
        changed = replace(changed, k1=float(np.clip(bundle.k1 + dx[-1], -STRONGEST, STRONGEST)))
    return changed


def _parts(groups: list[Group]) -> list[list[Group]]:
    return [groups[k * len(groups) // PARTS : (k + 1) * len(groups) // PARTS] for k in range(PARTS)]


def _eliminated(groups: list[Group], root: np.ndarray, side: np.ndarray, size: int) -> tuple[list[np.ndarray], np.ndarray, np.ndarray]:
    """The coupling of each of ``groups`` times ``root``, and what eliminating them takes from the camera block [size, size] and from the
    right side [size]."""
    carried, square, cross = [], np.zeros((size, size)), np.zeros(size)
    for group in groups:
        of = root[group.points] @ group.W
        rows = of.reshape(-1, of.shape[2])
        coupled = rows.T @ rows  # symmetric, which BLAS uses
        for (here, there), (here_too, there_too) in product(_stretches(group.columns), repeat=2):
            square[there, there_too] += coupled[here, here_too]
        cross[group.columns] += rows.T @ side[group.points].reshape(-1)
        carried.append(of)
    return carried, square, cross


def _stretches(columns: np.ndarray) -> list[tuple[slice, slice]]:
    """The stretches of consecutive numbers in ``columns`` [c], which increase: where each is in the array, and the numbers. Adding these as
    blocks takes a sixth of the time of adding them one by one."""
    cuts = [0, *(np.flatnonzero(np.diff(columns) != 1) + 1).tolist(), len(columns)]
    return [(slice(i, j), slice(int(columns[i]), int(columns[j - 1]) + 1)) for i, j in pairwise(cuts)]


def _diagonal(V: np.ndarray, damping: float) -> np.ndarray:
    diagonal = np.einsum("pii->pi", V)
    added = damping * diagonal + 1e-9 * diagonal.max(axis=1, keepdims=True) + 1e-12
    return added[:, :, None] * np.eye(V.shape[1])


def _cross(v: np.ndarray) -> np.ndarray:
    out = np.zeros((len(v), 3, 3))
    out[:, 0, 1], out[:, 0, 2], out[:, 1, 2] = -v[:, 2], v[:, 1], -v[:, 0]
    return out - out.transpose(0, 2, 1)


def rotations(w: np.ndarray) -> np.ndarray:
    """Rotation vectors [N, 3] to matrices [N, 3, 3] by Rodrigues' formula."""
    angle = np.linalg.norm(w, axis=1)[:, None, None]
    K = _cross(w)
    safe = np.maximum(angle, 1e-12)
    return np.asarray(np.eye(3) + np.sin(angle) / safe * K + (1 - np.cos(angle)) / safe**2 * K @ K)


def _tangents(d: np.ndarray) -> np.ndarray:
    """[P, 3, 2]: two unit vectors orthogonal to each direction and to each other."""
    helper = np.where(np.abs(d[:, 2:]) < 0.9, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]])
    first = np.cross(d, helper)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack([first, np.cross(d, first)], axis=2)
