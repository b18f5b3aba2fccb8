"""Similarity alignment of two sets of points, and the pose error that benchmarks report."""

from __future__ import annotations

import numpy as np


def similarity(source: np.ndarray, target: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """`(scale, R [3,3], t [3])` that minimise sum |scale R source + t - target|^2 (Umeyama, TPAMI 1991). Both [N,3], N >= 3.

    Raises ValueError when the points lie on a line or coincide: the rotation is then not determined.
    """
    if source.shape != target.shape or source.ndim != 2 or source.shape[1] != 3 or len(source) < 3:
        raise ValueError(f"similarity: two arrays [N,3] with N >= 3 expected, got {source.shape} and {target.shape}")
    mean_source, mean_target = source.mean(axis=0), target.mean(axis=0)
    a, b = source - mean_source, target - mean_target
    u, values, vt = np.linalg.svd(b.T @ a / len(a))
    if values[1] <= 1e-12 * max(values[0], np.finfo(float).tiny):
        raise ValueError("similarity: the points lie on a line, the rotation about it is not determined")
    signs = np.array([1.0, 1.0, np.sign(np.linalg.det(u) * np.linalg.det(vt))])
    R = u @ np.diag(signs) @ vt
    scale = float((values * signs).sum() / (a**2).sum(axis=1).mean())
    return scale, R, mean_target - scale * R @ mean_source


def camera_centres(cam_from_world: np.ndarray) -> np.ndarray:
    """[N,4,4] -> [N,3]: -R^T t."""
    return -np.einsum("nji,nj->ni", cam_from_world[:, :3, :3], cam_from_world[:, :3, 3])


def pose_error(cam_from_world: np.ndarray, truth: np.ndarray) -> dict[str, float]:
    """Error of registered cameras [N,4,4] against the truth [N,4,4] after aligning the centres by a similarity.

    `rms` and `max` are distances of centres in the truth's unit, `path` is the length of the true path, `percent` = 100 rms / path,
    `rotation_degrees` the median angle between the rotations.
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
