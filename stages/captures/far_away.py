"""Tells of captures that lie so far from the origin, as georeferenced ones do, that training in float32 loses digits of positions."""

from __future__ import annotations

import numpy as np

FAR = 1e4  # times the cameras' extent; the spacing of float32 is then a thousandth of the extent


def told_far(cam_from_world: np.ndarray) -> str | None:
    """A line for people if the cameras, [F, 4, 4] float64, are farther than `FAR` times their extent from the origin; else None."""
    R, t = cam_from_world[:, :3, :3], cam_from_world[:, :3, 3]
    centres = -np.einsum("fji,fj->fi", R, t)
    middle = centres.mean(0)
    extent, distance = float(np.linalg.norm(centres - middle, axis=1).max()), float(np.linalg.norm(middle))
    if extent == 0 or distance <= FAR * extent:
        return None
    where = ", ".join(f"{x:.6g}" for x in middle)
    return (
        f"the cameras are {distance:.3g} units from the origin, {distance / extent:.1g} times their extent, where float32 keeps too few "
        f"digits of positions for a sharp model; subtract an offset near ({where}) from all camera centres and points"
    )
