"""The viewer: shows our own renders as the background of a browser's 3D view, following its camera and panel."""

from __future__ import annotations

import threading
import time
from typing import NamedTuple

import numpy as np
import torch
import viser
import viser.transforms as tf

from ...rasterizer import Camera
from ...scene.camera_paths import upward
from ...scene.model import Model
from ...stages.exports.camera_path import looked_at
from ...stages.shared.posed_frameset import PosedFrameSet
from .looks import photo_beside, picture
from .panel import Controls, Panel
from .quiet import hush, unsaid
from .source import Found

SETTLED = 0.25  # s without a change after which the picture is drawn at full size
PER_SECOND = 20.0  # pictures per second while something moves; their size is chosen to reach this
SMALLEST, FIRST_SCALE = 0.15, 0.5  # of the full size
UPRIGHT = np.sin(np.radians(0.2))  # the roll up to which a camera counts as upright
SENT = 0.5  # s in which a browser may still report where its camera was before
QUALITY = (80, 95)  # of JPEG, while something moves and at rest


def next_scale(scale: float, seconds: float) -> float:
    """Scale of the next picture while something moves, as a share of the full side length, if one of ``scale`` took ``seconds``. The time
    depends only partly on the number of pixels. Steps are small, so that one slow picture causes no jump."""
    return float(np.clip(scale * np.clip((1 / PER_SECOND / seconds) ** 0.5, 0.7, 1.2), SMALLEST, 1.0))


def leans(pose: np.ndarray, up: np.ndarray) -> bool:
    """Whether the camera ``pose`` [4, 4], OpenCV, is rolled against the direction ``up`` [3], or looks along it."""
    return abs(float(pose[0, :3] @ up)) > UPRIGHT or float(-pose[1, :3] @ up) < UPRIGHT


class View(NamedTuple):
    """Everything that a browser's picture depends on."""

    wxyz: tuple[float, ...]
    position: tuple[float, ...]
    fov: float
    width: int
    height: int
    choice: Controls
    model: int


class Viewer:
    """Serves ``frames`` and the model last given to `show`, until `stop`.

    host, port: as from `listening`. The scene is turned about the mean up direction of the cameras.
    """

    def __init__(self, frames: PosedFrameSet, found: Found, host: str, port: int) -> None:
        self.frames, self.found, self.version = frames, found, 0
        self.rows = np.concatenate([frames.train, frames.val, frames.test])
        self.rows.sort()
        self.rendering = threading.Lock()  # kernels use all cores; two pictures at once would only take turns
        self.up = upward(frames.held(frames.train))
        hush()
        with unsaid():  # the command prints the address
            self.server = viser.ViserServer(host=host, port=port, label="e4dgs", verbose=False)
        self.port = self.server.get_port()
        self._look_from(frames.train[0])
        self.server.on_client_connect(lambda client: _Browser(self, client).run())

    def _look_from(self, i: int) -> None:
        """Makes browsers start where frame ``i`` was taken and orbit around the point that the cameras look at."""
        pose, K = self.frames.cam_from_world[i], self.frames.K[i]
        position = -pose[:3, :3].T @ pose[:3, 3]
        self.distance = max(float(np.linalg.norm(looked_at(self.frames, self.found.model) - position)), 1e-6)
        self.server.scene.set_up_direction(tuple(self.up.tolist()))
        camera = self.server.initial_camera
        camera.position, camera.look_at = position, position + self.distance * pose[2, :3]
        camera.up, camera.fov = -pose[1, :3] if self.leans(i) else self.up, 2 * float(np.arctan(0.5 * self.frames.height / K[1, 1]))

    def leans(self, i: int) -> bool:
        """Whether frame ``i`` was taken with a roll against the scene's up direction."""
        return leans(self.frames.cam_from_world[i], self.up)

    def show(self, found: Found) -> None:
        """Continues with another model."""
        self.found, self.version = found, self.version + 1

    def stop(self) -> None:
        with unsaid():
            self.server.stop()


class _Browser:
    """One browser: its panel, and a loop that draws its view."""

    def __init__(self, viewer: Viewer, client: viser.ClientHandle) -> None:
        self.viewer, self.client = viewer, client
        frames = viewer.frames
        seconds = float(np.ptp(frames.seconds)) if len(frames.seconds) else 0.0
        self.panel = Panel(client.gui, [frames.names[i] for i in viewer.rows], seconds, self._go)
        self.frame: int | None = None  # of the capture, to which the camera was last sent
        self.leaning = viewer.frames.train[0] if viewer.leans(viewer.frames.train[0]) else None  # rolled like this frame until one drags
        self.sent = time.monotonic()
        self.scale = FIRST_SCALE  # of the full size, while something moves

    def _go(self, row: int) -> None:
        frames = self.viewer.frames
        i = int(self.viewer.rows[row])
        pose, camera = frames.cam_from_world[i], self.client.camera
        with self.client.atomic():
            camera.position = -pose[:3, :3].T @ pose[:3, 3]
            camera.look_at = camera.position + self.viewer.distance * pose[2, :3]
            camera.up_direction = -pose[1, :3] if self.viewer.leans(i) else self.viewer.up
            camera.fov = 2 * float(np.arctan(0.5 * frames.height / frames.K[i][1, 1]))
        self.frame, self.sent = i, time.monotonic()
        self.leaning = i if self.viewer.leans(i) else None
        self.panel.at_frame(row, float(frames.time[i]))

    def _straighten(self, view: View) -> None:
        """Gives the camera the scene's up direction once a person moves it away from a frame that was taken with a roll: about the camera's
        own, a drag to the side would roll the scene and end under its floor."""
        if self.leaning is not None and time.monotonic() - self.sent > SENT and not self._looks_like(view, self.leaning):
            self.leaning = None
            self.client.camera.up_direction = self.viewer.up

    def _view(self) -> View:
        camera = self.client.camera
        size = max(camera.image_width, 16), max(camera.image_height, 16)
        pose = tuple(camera.wxyz.tolist()), tuple(camera.position.tolist())
        return View(*pose, float(camera.fov), *size, self.panel.choice(), self.viewer.version)

    def run(self) -> None:
        """Draws until the browser disconnects."""
        drawn, sharp = None, False
        seen, changed = None, 0.0
        before = time.monotonic()
        while self.client.client_id in self.viewer.server.get_clients():
            now = time.monotonic()
            if self.panel.playing:
                self.panel.advance(now - before)
            before = now
            view = self._view()
            if view != seen:
                seen, changed = view, now
                self._straighten(view)
            moving = now - changed < SETTLED
            if view == drawn and (moving or sharp):
                time.sleep(0.01)
                continue
            self._draw(view, moving)
            drawn, sharp = view, not moving

    def _draw(self, view: View, moving: bool) -> None:
        started = time.monotonic()
        scale = self.scale if moving else 1.0
        camera = self._camera(view, scale)
        choice, found = view.choice, self.viewer.found
        with self.viewer.rendering:
            shown = picture(found.model, camera, choice.time, choice.look, choice.primitives, choice.outlines)
        if choice.photo and self.frame is not None and self._stands_at(view, self.frame):
            photo = self.viewer.frames.composited(self.frame)
            shown = photo_beside(shown, photo, self.viewer.frames.K[self.frame], camera, choice.photo)
        self.client.scene.set_background_image(shown, format="jpeg", jpeg_quality=QUALITY[not moving])
        took = time.monotonic() - started
        if moving:
            self.scale = next_scale(scale, took)
        self._tell(found.model, found.title, camera, took)

    def _tell(self, model: Model, title: str, camera: Camera, took: float) -> None:
        counts = f"{len(model.gaussians):,} Gaussians, {len(model.convexes):,} convexes"
        self.panel.say(f"**{title}**\n\n{counts}\n\n{camera.width} x {camera.height} px in {1000 * took:.0f} ms")

    def _camera(self, view: View, scale: float) -> Camera:
        scale *= min(1.0, view.choice.longest / max(view.width, view.height))
        width, height = max(round(scale * view.width), 8), max(round(scale * view.height), 8)
        pose = np.eye(4)
        pose[:3, :3] = tf.SO3(np.array(view.wxyz)).as_matrix().T
        pose[:3, 3] = -pose[:3, :3] @ np.array(view.position)
        focal = 0.5 * height / np.tan(0.5 * view.fov)
        K = torch.tensor([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]], dtype=torch.float32)
        return Camera(K, torch.tensor(pose, dtype=torch.float32), width, height, self.viewer.found.model.near)

    def _stands_at(self, view: View, i: int) -> bool:
        """Whether the camera is where frame ``i`` was taken, and at its time."""
        return self._looks_like(view, i) and abs(view.choice.time - self.viewer.frames.time[i]) < 1e-3

    def _looks_like(self, view: View, i: int) -> bool:
        """Whether the camera is where frame ``i`` was taken."""
        frames = self.viewer.frames
        pose = frames.cam_from_world[i]
        turned = tf.SO3(np.array(view.wxyz)).as_matrix() @ pose[:3, :3]
        away = np.linalg.norm(np.array(view.position) + pose[:3, :3].T @ pose[:3, 3])
        return bool(np.abs(turned - np.eye(3)).max() < 2e-3 and away < 2e-3 * self.viewer.distance)
