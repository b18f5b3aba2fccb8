"""Camera paths through a scene, by name: a turntable, a spiral, or the capture's own path."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ...pipeline.choice.evenly import evenly

if TYPE_CHECKING:
    from ...scene.model import Model
    from ..shared.posed_frameset import PosedFrameSet

NAMES = ("turntable", "spiral", "capture")
USUAL_SECONDS = 4.0  # of a film where nothing says how long it should take
STOPS_A_SECOND = 2.0  # cameras that a tour of separate cameras visits; more would be hard to watch
LOOKS = 12  # cameras used to find the centre of the scene


@dataclass
class CameraPath:
    """n views. cam_from_world [n, 4, 4] OpenCV, world units; K [n, 3, 3] px; time [n] in [0, 1]."""

    cam_from_world: np.ndarray
    K: np.ndarray
    time: np.ndarray


def named_path(name: str, frames: PosedFrameSet, model: Model, count: int, seconds: float | None = None) -> CameraPath:
    """The path ``name`` (see `NAMES`), during which the capture plays once.

    "capture" follows the camera that moves, through the times that it saw. If the pictures are those of separate cameras (a rig, or a new
    camera at every time), it visits some of them, at most `STOPS_A_SECOND` of a film of ``seconds``, and travels around the scene between
    them. If there is one camera that stands still, so does the path. The others have the capture's first intrinsics.
    """
    from ...scene.camera_paths import spiral, turntable

    train = frames.train
    if name == "capture":
        return _along_capture(frames, model, count, USUAL_SECONDS if seconds is None else seconds)
    poses = frames.held(train)
    way = (turntable if name == "turntable" else spiral)(poses, looked_at(frames, model), count)
    return CameraPath(way, np.repeat(frames.K[train[:1]], count, axis=0), np.linspace(0, 1, count))


def seconds_of(name: str, frames: PosedFrameSet, moves: bool) -> float | None:
    """Seconds that the path ``name`` takes in real time: those of the capture, or of the camera that is followed. moves: whether time runs.
    None where nothing says how long it should take."""
    own = followed(frames) if name == "capture" else None
    if own is None and not moves:
        return None
    found = frames.seconds if own is None else frames.seconds[own]
    span = float(np.ptp(found)) if len(found) else 0.0
    return span if span > 0 else None


def followed(frames: PosedFrameSet) -> np.ndarray | None:
    """The training frames [n], in order of time, of the camera that moves, that with the most frames if several do. None if no camera
    moves: if all stand still, or every picture was taken from quite another place."""
    from .camera_tours import separate

    train = frames.train
    cameras, seen = np.unique(frames.camera[train], return_counts=True)
    candidates = [train[frames.camera[train] == cameras[k]] for k in np.argsort(-seen, kind="stable") if seen[k] > 1]
    for mine in candidates or [train]:
        mine = mine[np.argsort(frames.time[mine], kind="stable")]
        poses = frames.cam_from_world[mine]
        if np.ptp(poses, axis=0).max() > 0 and not separate(poses):
            return mine
    return None


def _along_capture(frames: PosedFrameSet, model: Model, count: int, seconds: float) -> CameraPath:
    from ...scene.camera_paths import along, upward
    from .camera_tours import tour, travelled

    own = followed(frames)
    if own is not None:
        time = frames.time[own]
        if (np.diff(time) > 0).all():
            at = np.interp(np.linspace(time[0], time[-1], count), time, np.arange(len(own)))
        else:  # several pictures of one time, as of a scene that stands still
            at = np.linspace(0, len(own) - 1, count)
        way = travelled(frames.cam_from_world[own], at, _centre(frames, model, own), upward(frames.held(own)))
        return CameraPath(way, _between(frames.K[own], at), np.interp(at, np.arange(len(own)), time))
    train = frames.train[np.argsort(frames.time[frames.train], kind="stable")]
    _, first = np.unique(frames.cam_from_world[train].reshape(len(train), 16), axis=0, return_index=True)
    cameras = train[np.sort(first)]
    poses, time = frames.cam_from_world[cameras], np.linspace(0, 1, count)
    if len(cameras) == 1:
        return CameraPath(along(poses, count), np.repeat(frames.K[cameras], count, axis=0), time)
    centre = looked_at(frames, model)
    stops = tour(poses, centre, max(2, round(STOPS_A_SECOND * seconds)))
    at = np.linspace(0, len(stops) - 1, count)
    leg, share = np.divmod(at, 1.0)
    at = leg + share * share * (3 - 2 * share)  # it slows down at every camera
    return CameraPath(travelled(poses[stops], at, centre, upward(frames.held(cameras))), _between(frames.K[cameras[stops]], at), time)


def _centre(frames: PosedFrameSet, model: Model, own: np.ndarray) -> np.ndarray:
    """`looked_at`, if a gap in the way of the frames ``own`` makes it needed; it takes some renders."""
    from .camera_tours import JUMP, turns

    return looked_at(frames, model) if (turns(frames.cam_from_world[own]) > JUMP).any() else np.zeros(3)


def _between(values: np.ndarray, at: np.ndarray) -> np.ndarray:
    """``values`` [n, 3, 3] at the places ``at`` [m] in [0, n - 1], linearly."""
    known = np.arange(len(values))
    return np.stack([np.interp(at, known, column) for column in values.reshape(len(values), 9).T], 1).reshape(-1, 3, 3)


def looked_at(frames: PosedFrameSet, model: Model) -> np.ndarray:
    """[3]: the median of the points that some training cameras see in the middle of their pictures, with depth rendered from the model. If
    they see none, the mean of its Gaussians, or a point ahead of the cameras if it has none."""
    import torch

    from ...rasterizer import Camera

    places = []
    for i in evenly(frames.train, LOOKS):
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
