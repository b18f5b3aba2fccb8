"""Captures that lie far from the origin, as georeferenced ones do, are moved to it: float32 loses digits of large positions."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

FAR = 1e3  # times the capture's extent; the spacing of float32 is then about a ten-thousandth of the extent, less than a pixel
ONE_PLACE = 1e-9  # of the distance; cameras within it stand still, up to rounding, and say nothing about the extent


class Placed(NamedTuple):
    """Where cameras and points are. poses: [F, 4, 4] float64, cameras from world, or None if some are unknown. points: [P, 3] or None.
    origin: [3], the point of the files' world that is the origin here; None if nothing was moved."""

    poses: np.ndarray | None
    points: np.ndarray | None
    origin: np.ndarray | None


def brought_near(poses: Sequence[np.ndarray | None], points: np.ndarray | None) -> Placed:
    """The ``poses`` [4, 4] of all frames and ``points`` of a capture's files, about another origin if they are far from theirs."""
    known = [pose for pose in poses if pose is not None]
    if len(known) < len(poses):
        return Placed(None, points, None)
    cam_from_world = np.stack(known)
    origin = far_origin(cam_from_world, points)
    if origin is None:
        return Placed(cam_from_world, points, None)
    return Placed(seen_from(origin, cam_from_world), None if points is None else points - origin, origin)


def far_origin(cam_from_world: np.ndarray, points: np.ndarray | None) -> np.ndarray | None:
    """A point [3] amid the cameras [F, 4, 4] float64, in round numbers, if they are farther from the origin than `FAR` times the extent of
    the capture; else None. The extent is that of the cameras, or the median distance of ``points`` [P, 3] from them if that is more."""
    R, t = cam_from_world[:, :3, :3], cam_from_world[:, :3, 3]
    centres = -np.einsum("fji,fj->fi", R, t)
    middle = centres.mean(0)
    extent, distance = float(np.linalg.norm(centres - middle, axis=1).max()), float(np.linalg.norm(middle))
    if points is not None and len(points):
        extent = max(extent, float(np.median(np.linalg.norm(points - middle, axis=1))))
    if not ONE_PLACE * distance < extent < distance / FAR:
        return None
    unit = 10.0 ** np.floor(np.log10(extent))
    return np.round(middle / unit) * unit


def seen_from(origin: np.ndarray, cam_from_world: np.ndarray) -> np.ndarray:
    """Poses [F, 4, 4] of the same cameras in a world whose origin is the point ``origin`` [3] of the old one."""
    moved = cam_from_world.copy()
    moved[:, :3, 3] += cam_from_world[:, :3, :3] @ origin
    return moved


def told_moved(origin: np.ndarray) -> str:
    """A line for people."""
    where = ", ".join(f"{x:.9g}" for x in origin)
    return (
        f"the cameras are far from the origin, where float32 keeps too few digits of positions; everything is moved by -({where}), "
        "and so are the model and all exports"
    )
