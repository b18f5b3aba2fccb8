"""`Bundle`: bundle adjustment of cameras that mostly turn, with the directions of the points and, if wanted, their distances. Uses only
numpy.

A point is a direction d from the world's origin and an inverse distance rho; a camera (R, t) sees it along R d + rho t. A point at
infinity is simply rho = 0, while in world coordinates it would diverge. This is the parametrisation of Yu and Gallup, "3D Reconstruction
from Accidental Motion" (CVPR 2014), but directions are adjusted too. Solved by Levenberg-Marquardt with the points eliminated first (Schur
complement) and Cauchy's loss as weights.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

CAUCHY = 2.385 / 1.1774  # width of the loss, times the median error of a Gaussian in two dimensions
FINEST = 0.01  # px
SETTLED = 1e-4  # relative change of the cost
STEPS = 25
STRONGEST = 0.5  # largest radial term


@dataclass(frozen=True)
class Bundle:
    """R [F, 3, 3], t [F, 3]: cam from world; d [P, 3] unit directions, rho [P] inverse distances; focal px, k1 (COLMAP's SIMPLE_RADIAL),
    centre [2] px. In observation o, frame `frame[o]` sees point `point[o]` at `xy[o]` px; xy is [O, 2]."""

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


def solve(bundle: Bundle, move: bool, lens: int) -> Bundle:
    """The adjusted bundle. Rotations and directions are always adjusted; `move` adds translations and distances; `lens` 1 adds the focal
    length, and 2 also k1."""
    damping = 1e-3
    errors = bundle.errors()
    scale = max(FINEST, CAUCHY * float(np.median(errors)))
    cost = _cost(errors, scale)
    for _ in range(STEPS):
        system = _normal(bundle, scale, move, lens)
        settled = False
        for _ in range(8):
            trial = _step(bundle, system, damping, move, lens)
            errors = trial.errors()
            now = _cost(errors, scale)
            if np.isfinite(now) and now < cost:
                settled = cost - now < SETTLED * cost
                bundle, damping = trial, max(1e-9, damping / 5)
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


def _normal(bundle: Bundle, scale: float, move: bool, lens: int) -> tuple[np.ndarray, ...]:
    """Normal equations: camera block A [C, C] and right side a [C], point blocks V [P, k, k] and v [P, k], and coupling W [P, k, C]."""
    frames, points = len(bundle.R), len(bundle.d)
    turned = np.einsum("oij,oj->oi", bundle.R[bundle.frame], bundle.d[bundle.point])
    local = turned + bundle.rho[bundle.point, None] * bundle.t[bundle.frame]
    z = np.where(local[:, 2] > 1e-6, local[:, 2], np.inf)
    u = local[:, :2] / z[:, None]
    r2 = (u**2).sum(axis=1)
    bent = u * (1 + bundle.k1 * r2)[:, None]
    residual = np.where(np.isfinite(z)[:, None], bundle.focal * bent + bundle.centre - bundle.xy, 0.0)
    weight = 1 / (1 + (residual**2).sum(axis=1) / scale**2)

    to_u = np.zeros((len(z), 2, 3))
    to_u[:, 0, 0] = to_u[:, 1, 1] = 1 / z
    to_u[:, :, 2] = -u / z[:, None]
    bend = (1 + bundle.k1 * r2)[:, None, None] * np.eye(2) + 2 * bundle.k1 * u[:, :, None] * u[:, None, :]
    G = bundle.focal * np.einsum("oij,ojk->oik", bend, to_u)

    per = 6 if move else 3
    J_camera = np.zeros((len(z), 2, per))
    J_camera[:, :, :3] = -np.einsum("oij,ojk->oik", G, _cross(turned))
    basis = _tangents(bundle.d)
    k = 3 if move else 2
    J_point = np.zeros((len(z), 2, k))
    J_point[:, :, :2] = np.einsum("oij,ojk,okl->oil", G, bundle.R[bundle.frame], basis[bundle.point])
    if move:
        J_camera[:, :, 3:] = G * bundle.rho[bundle.point, None, None]
        J_point[:, :, 2] = np.einsum("oij,oj->oi", G, bundle.t[bundle.frame])
    extra = lens
    J_lens = np.stack([bundle.focal * bent, bundle.focal * u * r2[:, None]], axis=2)[:, :, :extra]

    size = per * frames + extra
    A, a = np.zeros((size, size)), np.zeros(size)
    camera_blocks, lens_blocks = np.zeros((frames, per, per)), np.zeros((frames, per, extra))
    sides = np.zeros((frames, per))
    wJ = weight[:, None, None] * J_camera
    np.add.at(camera_blocks, bundle.frame, np.einsum("oij,oik->ojk", wJ, J_camera))
    np.add.at(lens_blocks, bundle.frame, np.einsum("oij,oik->ojk", wJ, J_lens))
    np.add.at(sides, bundle.frame, np.einsum("oij,oi->oj", wJ, residual))
    for i in range(frames):
        at = slice(per * i, per * (i + 1))
        A[at, at], a[at] = camera_blocks[i], sides[i]
        A[at, per * frames :], A[per * frames :, at] = lens_blocks[i], lens_blocks[i].T
    A[per * frames :, per * frames :] = np.einsum("o,oij,oik->jk", weight, J_lens, J_lens)
    a[per * frames :] = np.einsum("o,oij,oi->j", weight, J_lens, residual)

    V, v, W = np.zeros((points, k, k)), np.zeros((points, k)), np.zeros((points, k, size))
    wP = weight[:, None, None] * J_point
    np.add.at(V, bundle.point, np.einsum("oij,oik->ojk", wP, J_point))
    np.add.at(v, bundle.point, np.einsum("oij,oi->oj", wP, residual))
    joined = np.einsum("oij,oik->ojk", wP, J_camera)
    columns = per * bundle.frame[:, None] + np.arange(per)
    np.add.at(W, (bundle.point[:, None, None], np.arange(k)[None, :, None], columns[:, None, :]), joined)
    lens_joined = np.zeros((points, k, extra))
    np.add.at(lens_joined, bundle.point, np.einsum("oij,oik->ojk", wP, J_lens))
    W[:, :, per * frames :] = lens_joined
    return A, a, V, v, W


def _step(bundle: Bundle, system: tuple[np.ndarray, ...], damping: float, move: bool, lens: int) -> Bundle:
    A, a, V, v, W = system
    frames, per = len(bundle.R), 6 if move else 3
    # a floor under the diagonal keeps unmeasured quantities (the world's rotation, scale and origin; distances under no angle) in place
    damped = V + _diagonal(V, damping)
    inverse = np.linalg.inv(damped)
    carried = np.einsum("pij,pjc->pic", inverse, W)
    flat, flat_carried = W.reshape(-1, W.shape[2]), carried.reshape(-1, W.shape[2])
    S = A + np.diag(damping * np.diag(A) + 1e-9 * np.trace(A) / len(A)) - flat.T @ flat_carried
    s = a - flat_carried.T @ v.reshape(-1)
    try:
        dx = -np.linalg.solve(S, s)
    except np.linalg.LinAlgError:
        return bundle
    dp = -np.einsum("pij,pj->pi", inverse, v) - np.einsum("pic,c->pi", carried, dx)
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
