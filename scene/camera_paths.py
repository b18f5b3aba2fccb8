"""Camera paths: around the subject of the capture, on a small spiral in front of it, or along the capture's own cameras.

Poses are cam_from_world [n, 4, 4], OpenCV (x right, y down, z forward), world units.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

REACH, MOST_REACH = 0.12, 0.25  # of the viewing distance: how far a spiral goes to the side, at least and at most
BETWEEN = 0.7  # of the way from the mean camera to the outermost, so that a spiral stays between the cameras
TRUST = 0.005  # in the mean up direction, against the squared sine of the cameras' roll
GAP = 90.0  # degrees; with a gap this wide between cameras around the target, the path does not close around it
SWING, STANDING = 12.0, 3.0  # degrees to either side, at least; for one camera that stands still
TURNS = 2  # of a spiral


def look_at(eye: np.ndarray, target: np.ndarray, up: np.ndarray) -> np.ndarray:
    """cam_from_world [4, 4] of a camera at ``eye`` [3] that has ``target`` [3] in the centre of the image and ``up`` [3] pointing upwards.

    Raises ValueError if eye and target coincide or up is parallel to the viewing direction.
    """
    forward = np.asarray(target, np.float64) - eye
    right = np.cross(forward, up)
    lengths = np.linalg.norm(forward), np.linalg.norm(right)
    if min(lengths) < 1e-9 * max(1.0, float(np.linalg.norm(target))):
        raise ValueError("look_at: the camera stands on its target, or looks along its up direction")
    z, x = forward / lengths[0], right / lengths[1]
    pose = np.eye(4)
    pose[:3, :3] = np.stack([x, np.cross(z, x), z])
    pose[:3, 3] = -pose[:3, :3] @ eye
    return pose


def centres(poses: np.ndarray) -> np.ndarray:
    """Camera centres [n, 3]."""
    return -np.einsum("nji,nj->ni", poses[:, :3, :3], poses[:, :3, 3])


def upward(poses: np.ndarray) -> np.ndarray:
    """Unit vector [3] that points upwards in the scene: near the mean up direction of the cameras ``poses`` [n, 4, 4], and as far as they
    tell level for their right directions. The mean alone is off by some degrees if more of them look down from one side than from the
    other, while people seldom roll a camera."""
    right, up = poses[:, 0, :3], -poses[:, 1, :3].mean(0)
    up = np.linalg.solve(right.T @ right / len(right) + TRUST * np.eye(3), up)
    length = np.linalg.norm(up) * TRUST
    return up / np.linalg.norm(up) if length > 1e-6 else -poses[0, 1, :3]


def stand_still(poses: np.ndarray) -> bool:
    """Whether several ``poses`` [F, 4, 4] are those of one camera that stands still."""
    return len(poses) > 1 and not np.ptp(poses, axis=0).any()


def turntable(poses: np.ndarray, target: np.ndarray, count: int) -> np.ndarray:
    """[count, 4, 4] around ``target`` [3], at the median distance and height of the cameras ``poses``; a closed path.

    It is a circle if the cameras surround the target. If they see only one side, it swings back and forth between the outermost cameras,
    and hardly at all for one that stands still, beside which nothing is known.
    """
    up, offset = upward(poses), centres(poses) - target
    height = float(np.median(offset @ up))
    flat = offset - (offset @ up)[:, None] * up
    radius = float(np.median(np.linalg.norm(flat, axis=1)))
    distance = float(np.median(np.linalg.norm(offset, axis=1)))
    radius = max(radius, 0.2 * distance)  # cameras straight above would give a circle without a radius
    first = flat[np.linalg.norm(flat, axis=1).argmax()]
    first = first - (first @ up) * up
    if np.linalg.norm(first) < 1e-9:
        first = np.cross(up, [1.0, 0, 0]) if abs(up[0]) < 0.9 else np.cross(up, [0, 1.0, 0])
    side = first / np.linalg.norm(first)
    other = np.cross(up, side)
    angles = _around(
        np.arctan2(flat @ other, flat @ side), np.linspace(0, 2 * np.pi, count, endpoint=False), STANDING if stand_still(poses) else SWING
    )
    eyes = target + height * up + radius * (np.cos(angles)[:, None] * side + np.sin(angles)[:, None] * other)
    return np.stack([look_at(eye, target, up) for eye in eyes])


def _around(azimuths: np.ndarray, phase: np.ndarray, swing: float) -> np.ndarray:
    """Angles [count] of a path at ``phase`` [count] from 0 to 2 pi: the phase itself, or a swing over the range of ``azimuths`` [n], and of
    at least ``swing`` degrees to either side."""
    known = np.sort(np.mod(azimuths, 2 * np.pi))
    gaps = np.diff(np.append(known, known[0] + 2 * np.pi))
    widest = int(gaps.argmax())
    if gaps[widest] < np.radians(GAP):
        return phase
    covered = 2 * np.pi - gaps[widest]
    start = known[(widest + 1) % len(known)]
    return start + 0.5 * covered + max(0.5 * covered, np.radians(swing)) * np.sin(phase)


def spiral(poses: np.ndarray, target: np.ndarray, count: int) -> np.ndarray:
    """[count, 4, 4] around the camera of ``poses`` nearest to their mean position, always facing ``target`` [3]; a closed path.

    Its extent to each side follows that of the cameras, within limits, so that it still moves a little if all cameras stand in one place.
    """
    eyes, up = centres(poses), upward(poses)
    middle = poses[np.linalg.norm(eyes - eyes.mean(0), axis=1).argmin()]
    eye = centres(middle[None])[0]
    distance = float(np.linalg.norm(target - eye))
    axes = middle[:3, :3]
    spread = np.percentile(np.abs((eyes - eye) @ axes.T), 90, axis=0)
    usual = distance * np.array([1, 0.5, 0.25])
    least = np.tan(np.radians(STANDING)) if stand_still(poses) else REACH
    reach = np.clip(BETWEEN * spread, least * usual, MOST_REACH * usual)
    angles = np.linspace(0, 2 * np.pi * TURNS, count, endpoint=False)
    shift = np.stack([np.cos(angles), np.sin(angles), np.sin(angles / TURNS)], 1) * reach
    return np.stack([look_at(eye + s @ axes, target, up) for s in shift])


def along(poses: np.ndarray, count: int, at: np.ndarray | None = None) -> np.ndarray:
    """[count, 4, 4] through ``poses`` [n, 4, 4] in order, from the first to the last, in even steps between them; or at the places ``at``
    [count] in [0, n - 1] of the way. Between neighbours it goes straight."""
    if len(poses) == 1:
        return np.repeat(poses, count, axis=0)
    known, wanted = np.arange(len(poses)), np.linspace(0, len(poses) - 1, count) if at is None else at
    eyes = centres(poses)
    result = np.tile(np.eye(4), (count, 1, 1))
    result[:, :3, :3] = Slerp(known, Rotation.from_matrix(poses[:, :3, :3]))(wanted).as_matrix()
    between = np.stack([np.interp(wanted, known, eyes[:, c]) for c in range(3)], 1)
    result[:, :3, 3] = -np.einsum("nij,nj->ni", result[:, :3, :3], between)
    return result
