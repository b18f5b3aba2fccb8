"""How far cameras are from the truth, for tests and benchmarks."""

from __future__ import annotations

import numpy as np
from e4dgs.vision.sfm.alignment import camera_centres, similarity


def pose_error(cam_from_world: np.ndarray, truth: np.ndarray) -> dict[str, float]:
    """Error of registered cameras [N,4,4] against the truth [N,4,4], after aligning the centres by a similarity.

    `rms` and `max` are distances between centres in the truth's unit, `path` is the length of the true path, `percent` is
    100 rms / path, and `rotation_degrees` is the median angle between the rotations.
    """
    centres, true_centres = camera_centres(cam_from_world), camera_centres(truth)
    scale, R, t = similarity(centres, true_centres)
    distance = np.linalg.norm(scale * centres @ R.T + t - true_centres, axis=1)
    path = float(np.linalg.norm(np.diff(true_centres, axis=0), axis=1).sum())
    relative = cam_from_world[:, :3, :3] @ R.T @ truth[:, :3, :3].transpose(0, 2, 1)
    cosine = np.clip((np.trace(relative, axis1=1, axis2=2) - 1) / 2, -1, 1)
    rms = float(np.sqrt((distance**2).mean()))
    return {
        "rms": rms,
        "max": float(distance.max()),
        "path": path,
        "percent": 100 * rms / path,
        "rotation_degrees": float(np.degrees(np.median(np.arccos(cosine)))),
    }
