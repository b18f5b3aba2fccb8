"""A trained model and the cameras of its capture as the data of the web player, with a picture to show before they are there."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from io import BytesIO
from typing import TYPE_CHECKING, Any

import numpy as np

from ...pipeline import counted
from ...pipeline.choice.evenly import evenly
from ...scene.metrics.psnr import decibels
from .capture_cameras import camera_of, distinct_views
from .web_scene import web_scene

if TYPE_CHECKING:
    from ...scene.formats.web.scene import WebScene
    from ...scene.model import Model
    from ..shared.posed_frameset import PosedFrameSet

CAMERAS = 48  # of the capture's, to which the page can jump
LOOKS = 6  # views by which the file is compared with the model
POSTER_SIDE, POSTER_QUALITY = 960, 80  # px of the longer side; of a JPEG


@dataclass
class Lost:
    """psnr: dB, renders of the file against renders of the model, mean squared error over ``views`` views at as many times."""

    psnr: float
    views: int

    def __str__(self) -> str:
        return f"{self.psnr:.1f} dB from the model over {counted(self.views, 'view')}"


@dataclass
class ExportedWeb:
    """data: the file of the scene. poster: JPEG. header: see docs/player.md. loss: how far the file is from the model."""

    data: bytes
    poster: bytes
    header: dict[str, Any]
    loss: Lost

    def __str__(self) -> str:
        gaussians, convexes, seconds = sum(self.header["gaussians"]), sum(self.header["convexes"]), self.header["seconds"]
        size = f"{len(self.data) / 1e6:.2f} MB"
        size += f", {len(self.data) / 1e6 / seconds:.2f} MB a second" if seconds > 0 and self.header["motion"] != "static" else ""
        shapes = f"{counted(gaussians, 'Gaussian')}, {counted(convexes, 'convex', 'convexes')}"
        return f"{shapes}, motion {self.header['motion']}; {size}; {self.loss}"


def export_web(model: Model, frames: PosedFrameSet, times: int, advance: Callable[[int], None] = lambda n: None) -> ExportedWeb:
    """``model`` as the web player shows it. times: of the capture. ``advance`` is called after each of three parts."""
    from ...scene.formats.web.scene import WebScene

    device = model.device
    model.to("cpu")
    try:
        about = about_capture(model, frames)
        advance(1)
        scene, steps = web_scene(model, times, pixel_width(frames, np.array(about["target"])), about)
        data = scene.to_bytes(steps)
        advance(1)
        found = ExportedWeb(data, poster(model, frames), scene.header, lost(model, WebScene.from_bytes(data), frames))
        advance(1)
    finally:
        model.to(device)
    return found


def light_web(model: Model, frames: PosedFrameSet, times: int, most: int) -> tuple[bytes, bytes] | None:
    """The file and the poster of `export_web`, with as many SH bands as ``most`` bytes have room for; None if even one is too large."""
    device = model.device
    model.to("cpu")
    try:
        about = about_capture(model, frames)
        scene, steps = web_scene(model, times, pixel_width(frames, np.array(about["target"])), about)
        first = poster(model, frames)
    finally:
        model.to(device)
    while len(data := scene.to_bytes(steps)) > most:
        if not (degree := scene.header["sh_degree"]):
            return None
        scene.header["sh_degree"] = degree - 1
    return data, first


def poster(model: Model, frames: PosedFrameSet) -> bytes:
    """What the page shows first, as JPEG: the model from the camera with which the page begins."""
    from PIL import Image

    first = int(distinct_views(frames, frames.train, CAMERAS)[0])
    drawn = model.render(camera_of(model, frames, first), float(frames.time[first])).color.detach().cpu().clamp(0, 1)
    picture = Image.fromarray((drawn * 255).round().byte().numpy())
    picture.thumbnail((POSTER_SIDE, POSTER_SIDE))
    target = BytesIO()
    picture.save(target, "JPEG", quality=POSTER_QUALITY)
    return target.getvalue()


def about_capture(model: Model, frames: PosedFrameSet) -> dict[str, Any]:
    """The fields of the header that come from the capture: seconds, up, target, cameras."""
    from ...scene.camera_paths import upward
    from .camera_path import looked_at

    chosen = distinct_views(frames, frames.train, CAMERAS)
    cameras = [
        {
            "name": frames.names[i],
            "time": float(frames.time[i]),
            "width": frames.width,
            "height": frames.height,
            "cam_from_world": [float(f"{x:.9g}") for x in frames.cam_from_world[i].reshape(-1)],
            "K": [float(f"{x:.9g}") for x in frames.K[i].reshape(-1)],
        }
        for i in chosen
    ]
    up, target = upward(frames.held(frames.train)), looked_at(frames, model)
    return {"seconds": float(np.ptp(frames.seconds)), "up": up.tolist(), "target": np.asarray(target).tolist(), "cameras": cameras}


def pixel_width(frames: PosedFrameSet, target: np.ndarray) -> float:
    """Width of a pixel at ``target`` [3], world units: the median over the training cameras."""
    poses = frames.cam_from_world[frames.train]
    depth = np.abs(poses[:, 2, :3] @ target + poses[:, 2, 3])
    return float(np.median(np.maximum(depth, 1e-6) / frames.K[frames.train][:, 0, 0]))


def lost(model: Model, scene: WebScene, frames: PosedFrameSet) -> Lost:
    """How far renders of ``scene`` are from those of ``model``, from held-out cameras if there are enough, at their own times."""
    chosen = np.concatenate([frames.test, frames.val])
    chosen = chosen if len(chosen) >= LOOKS else np.concatenate([chosen, frames.train])
    chosen = evenly(chosen, LOOKS)
    error = []
    for i in chosen:
        camera, t = camera_of(model, frames, int(i)), float(frames.time[i])
        pair = [drawn.render(camera, t).color.detach().cpu().clamp(0, 1) for drawn in (model, scene)]
        error.append(float((pair[0] - pair[1]).square().mean()))
    return Lost(decibels(float(np.mean(error))), len(chosen))
