"""Camera paths through a scene, by name: a turntable, a spiral, or the capture's own path."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from ...scene.model import Model
    from ..artifacts.frameset import FrameSet

NAMES = ("turntable", "spiral", "capture")
LOOKS = 12  # cameras used to find the centre of the scene


@dataclass
class CameraPath:
    """n views. cam_from_world [n, 4, 4] OpenCV, world units; K [n, 3, 3] px; time [n] in [0, 1]."""

    cam_from_world: np.ndarray
    K: np.ndarray
    time: np.ndarray


def named_path(name: str, frames: FrameSet, model: Model, count: int) -> CameraPath:
    """The path ``name`` (see `NAMES`) with the capture's first intrinsics, during which the capture plays once. "capture" follows the
    camera with the most training frames, so it stands still if that camera did."""
    from ...scene.camera_paths import along, spiral, turntable

    assert frames.cam_from_world is not None and frames.K is not None
    train = frames.train
    time = np.linspace(0, 1, count)
    if name == "capture":
        cameras, seen = np.unique(frames.camera[train], return_counts=True)
        mine = train[frames.camera[train] == cameras[seen.argmax()]] if seen.max() > 1 else train
        mine = mine[np.argsort(frames.time[mine], kind="stable")]
        at = np.interp(np.linspace(0, len(mine) - 1, count), np.arange(len(mine)), frames.time[mine])
        return CameraPath(along(frames.cam_from_world[mine], count), np.repeat(frames.K[mine[:1]], count, axis=0), at)
    poses = frames.cam_from_world[train]
    way = (turntable if name == "turntable" else spiral)(poses, looked_at(frames, model), count)
    return CameraPath(way, np.repeat(frames.K[train[:1]], count, axis=0), time)


def looked_at(frames: FrameSet, model: Model) -> np.ndarray:
    """[3]: the median of the points that some training cameras see in the middle of their pictures, with depth rendered from the model. If
    they see none, the mean of its Gaussians, or a point ahead of the cameras if it has none."""
    import torch

    from ...rasterizer import Camera

    assert frames.cam_from_world is not None and frames.K is not None
    places = []
    for i in frames.train[np.linspace(0, len(frames.train) - 1, min(LOOKS, len(frames.train))).round().astype(int)]:
        K, pose = frames.K[i], frames.cam_from_world[i]
        camera = Camera(torch.tensor(K).float(), torch.tensor(pose).float(), frames.width, frames.height, model.near)
        frame = model.render(camera, float(frames.time[i]))
        top, left = frames.height // 4, frames.width // 4
        inner = np.s_[top : frames.height - top, left : frames.width - left]
        depth, solid = frame.depth.cpu().numpy()[inner], frame.alpha.cpu().numpy()[inner] > 0.5
        if solid.any():
            ahead = np.array([0.0, 0.0, float(np.median(depth[solid]))])
            places.append(pose[:3, :3].T @ (ahead - pose[:3, 3]))
    if places:
        return np.median(places, axis=0)
    if len(model.gaussians):
        return model.gaussians.means.detach().cpu().numpy().astype(np.float64).mean(0)
    poses = frames.cam_from_world[frames.train]  # with nothing to look at, any point ahead of the cameras will do
    centres = -np.einsum("nji,nj->ni", poses[:, :3, :3], poses[:, :3, 3])
    return centres.mean(0) + poses[:, 2, :3].mean(0) * max(float(np.linalg.norm(centres - centres.mean(0), axis=1).max()), 1.0)
