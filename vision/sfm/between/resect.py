"""`resect`: the pose of a camera that sees known points, near an expected one."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from ..alignment import camera_centres

STEPS = 12
DONE = 1e-9  # a step below which the adjustment ends: radians, and a share of the points' median depth


def resect(points: np.ndarray, seen: np.ndarray, expected: np.ndarray, scale: float, loose: float) -> tuple[np.ndarray, np.ndarray]:
    """(cam_from_world [4, 4], errors [N]) that minimise the sum of Cauchy's loss over ``points`` [N, 3] seen at ``seen`` [N, 2], in
    units of the focal length, beginning at ``expected`` [4, 4].

    scale: of the loss, in units of the focal length. loose: standard deviation, in world units, of the camera's centre from that of
    ``expected``; it decides only where the points leave the centre open, as they do if the camera hardly moves. Errors are inf behind
    the camera. Gauss and Newton's steps with weights (Holland and Welsch 1977).
    """
    pose = np.array(expected, np.float64)
    centre = camera_centres(pose[None])[0]
    pull = (scale / max(loose, 1e-12)) ** 2
    for _ in range(STEPS):
        local = points @ pose[:3, :3].T + pose[:3, 3]
        front = local[:, 2] > 0
        if not front.any():
            break
        x, y, z = local[front].T
        residual = np.stack([x / z, y / z], 1) - seen[front]
        weight = 1 / (1 + (residual**2).sum(1) / scale**2)
        zero = np.zeros_like(x)
        # of a turn and a shift that are applied after the pose: p' = p + turn x p + shift
        J = np.stack(
            [
                np.stack([-x * y / z**2, 1 + (x / z) ** 2, -y / z, 1 / z, zero, -x / z**2], 1),
                np.stack([-1 - (y / z) ** 2, x * y / z**2, x / z, zero, 1 / z, -y / z**2], 1),
            ],
            1,
        )
        A = np.einsum("n,nkp,nkq->pq", weight, J, J)
        b = np.einsum("n,nkp,nk->p", weight, J, residual)
        R = pose[:3, :3]
        A[3:, 3:] += pull * np.eye(3)  # the centre moves by -R^T shift
        b[3:] -= pull * R @ (camera_centres(pose[None])[0] - centre)
        step = -np.linalg.lstsq(A, b, rcond=None)[0]
        turn = np.eye(4)
        turn[:3, :3], turn[:3, 3] = Rotation.from_rotvec(step[:3]).as_matrix(), step[3:]
        pose = turn @ pose
        if np.abs(step[:3]).max() < DONE and np.abs(step[3:]).max() < DONE * np.median(z):
            break
    local = points @ pose[:3, :3].T + pose[:3, 3]
    with np.errstate(all="ignore"):
        errors = np.linalg.norm(local[:, :2] / local[:, 2:] - seen, axis=1)
    return pose, np.where(local[:, 2] > 0, errors, np.inf)
