"""The cameras that filmed a capture, for the files of other programs."""

from __future__ import annotations

import json
from typing import Any

import numpy as np

from ...scene.formats.axes import OPENGL, Turn
from ...scene.formats.usd.cameras import PosedCamera
from ..shared.posed_frameset import PosedFrameSet


def posed(frames: PosedFrameSet) -> np.ndarray:
    """The frames [n] of all splits that have a pose."""
    return np.sort(np.concatenate([frames.train, frames.val, frames.test]))


def cameras_json(frames: PosedFrameSet, turn: Turn) -> bytes:
    """All posed frames in nerfstudio's layout (transforms.json), with their times: poses in the axes of a file that ``turn`` leads to, so
    beside an export that was turned by it, and lenses of the pictures without distortion at the capture's size.

    file_from_capture takes points of the capture's own files to these axes; `e4dgs render --path` reads it."""
    file_from_world = np.eye(4)
    file_from_world[:3, :3] = turn.matrix
    rows: list[dict[str, Any]] = []
    for i in posed(frames):
        K = frames.K[i]
        world_from_cam = np.linalg.inv(frames.cam_from_world[i]) @ OPENGL
        lens = {"fl_x": K[0, 0], "fl_y": K[1, 1], "cx": K[0, 2], "cy": K[1, 2]}
        row = {"file_path": frames.names[i], "camera": int(frames.camera[i]), "time": float(frames.time[i])}
        row |= {name: float(value) for name, value in lens.items()}
        rows.append(row | {"transform_matrix": (file_from_world @ world_from_cam).tolist()})
    if frames.origin is not None:
        file_from_world[:3, 3] = -turn.matrix @ frames.origin
    about = {"camera_model": "PINHOLE", "w": frames.width, "h": frames.height, "file_from_capture": file_from_world.tolist()}
    head, body = json.dumps(about)[:-1], ",\n".join(json.dumps(row) for row in rows)  # a line a frame
    return f'{head}, "frames": [\n{body}\n]}}\n'.encode()


def posed_cameras(frames: PosedFrameSet, near: float) -> list[PosedCamera]:
    """Each camera of the capture with its posed frames in order of time. near: depth at which the scene begins, world units."""
    found, own = [], posed(frames)
    for camera in np.unique(frames.camera[own]):
        mine = own[frames.camera[own] == camera]
        mine = mine[np.argsort(frames.time[mine], kind="stable")]
        poses, K, name = frames.cam_from_world[mine], frames.K[mine], f"cam{int(camera):02d}"
        found.append(PosedCamera(name, frames.time[mine], poses, K, frames.width, frames.height, near))
    return found
