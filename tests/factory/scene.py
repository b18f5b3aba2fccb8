"""Scenes, the views of a capture, and the one options object that makes both."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from .camera import Camera, intrinsics, look_at
from .motion import Motion
from .shapes import Box, Shape, Sphere
from .textures import Cells, Checker, Stripes, Texture

Split = Literal["train", "val", "test"]
STILL = Motion()


@dataclass(frozen=True)
class Object:
    """A shape with its texture and motion."""

    name: str
    shape: Shape
    texture: Texture
    motion: Motion = STILL


@dataclass(frozen=True)
class Scene:
    """Objects under one lamp. `light` is the lamp's share: at 0 a surface point has one colour for ever (flow is then exact
    in brightness too), at 1 Lambert's wrapped shading rules alone."""

    objects: tuple[Object, ...]
    light: float = 0.0
    lamp: tuple[float, float, float] = (0.4, -0.5, 0.85)

    @property
    def moves(self) -> bool:
        return any(item.motion.moves for item in self.objects)


@dataclass(frozen=True)
class View:
    """One frame of a capture: which camera, when (time in [0,1], its index among the times), and its split."""

    camera_index: int
    time_index: int
    time: float
    camera: Camera
    split: Split = "train"


@dataclass(frozen=True)
class Options:
    """Everything that makes a synthetic capture.

    backdrop: nothing, a slab to stand on, or a room around the cameras (rich texture everywhere: for SfM).
    rig: "orbit" has a new camera on a dome at every time (D-NeRF); "arc" has `cameras` fixed, synchronised ones; "path" is one
    hand-held camera. motion scales all movement (0: nothing moves), deform adds squash and stretch to spheres.
    val, test: held-out views, on "orbit" only; on "arc" camera 0 is the test camera.
    distortion, fisheye: of every camera, see `Camera`. sizes: width and height of the cameras' pictures in turn ("arc": by camera, else by
    view), all of `fov_degrees`, for rigs and folders of mixed sizes; `width` and `height` where empty.
    """

    backdrop: Literal["none", "slab", "room"] = "slab"
    boxes: int = 1
    spheres: int = 1
    motion: float = 1.0
    deform: float = 0.0
    light: float = 0.0
    rig: Literal["orbit", "arc", "path"] = "orbit"
    cameras: int = 4
    times: int = 12
    val: int = 2
    test: int = 4
    width: int = 64
    height: int = 64
    fov_degrees: float = 45.0
    sizes: tuple[tuple[int, int], ...] = ()
    distortion: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0)
    fisheye: bool = False
    fps: float = 30.0
    samples: int = 4
    seed: int = 0


@dataclass(frozen=True)
class Synthetic:
    """A scene and the views that a capture of it holds, in the order in which writers put them into files."""

    scene: Scene
    views: tuple[View, ...]
    options: Options

    def split(self, name: Split) -> tuple[View, ...]:
        return tuple(view for view in self.views if view.split == name)


def make(options: Options) -> Synthetic:
    """Make scene and views; the same options always give the same bits."""
    if options.cameras < 1 or options.times < 1:
        raise ValueError(f"a capture needs cameras and times, not cameras={options.cameras}, times={options.times}")
    rng = np.random.default_rng(options.seed)
    return Synthetic(_make_scene(options, rng), _make_views(options, rng), options)


def _make_scene(options: Options, rng: np.random.Generator) -> Scene:
    objects: list[Object] = []
    count = max(1, options.boxes + options.spheres)
    ground = 0.0
    if options.backdrop == "room":
        objects.append(Object("room", Box((4.0, 4.0, 2.0), inside=True), Cells(0.9, options.seed), Motion((0.0, 0.0, 2.0))))
    elif options.backdrop == "slab":
        objects.append(Object("slab", Box((1.5, 1.5, 0.1)), Cells(0.6, options.seed), Motion((0.0, 0.0, -0.1))))
    for i in range(options.boxes + options.spheres):
        angle = 2.0 * np.pi * i / count + rng.uniform(-0.2, 0.2)
        reach = 0.75 if count > 1 else 0.0
        x, y = reach * np.cos(angle), reach * np.sin(angle)
        m, size = options.motion, rng.uniform(0.32, 0.42)
        slide = (-0.5 * m * np.sin(angle), 0.5 * m * np.cos(angle), 0.0)
        if i < options.boxes:
            motion = Motion((x, y, ground + size), slide, turn=1.4 * m, rest_angle=angle)
            objects.append(Object(f"box{i}", Box((size, size, size)), Checker(size / 2.0), motion))
        else:
            turn, bounce = 0.8 * m, 0.5 * m
            centre = (x, y, ground + size + 0.1)
            motion = Motion(centre, slide, (1.0, 0.3, 0.2), turn, 0.0, bounce, 2, options.deform)
            texture = Stripes(size / 3.0) if options.backdrop == "slab" else Cells(size, options.seed + i)
            objects.append(Object(f"sphere{i}", Sphere(size), texture, motion))
    return Scene(tuple(objects), options.light)


def _make_views(options: Options, rng: np.random.Generator) -> tuple[View, ...]:
    times = np.linspace(0.0, 1.0, options.times) if options.times > 1 else np.zeros(1)
    target = np.array([0.0, 0.0, 0.35])

    def camera(eye: np.ndarray, index: int) -> Camera:
        width, height = options.sizes[index % len(options.sizes)] if options.sizes else (options.width, options.height)
        K = intrinsics(width, height, options.fov_degrees)
        return Camera(K, look_at(eye, target), width, height, options.distortion, options.fisheye)

    radius = 3.2 if options.backdrop == "room" else 5.2
    if options.rig == "orbit":
        views = []
        splits: list[tuple[Split, int]] = [("train", options.times), ("val", options.val), ("test", options.test)]
        for split, count in splits:
            moments = times if split == "train" else (np.arange(count) + 0.5) / max(count, 1)
            azimuths = rng.permutation(count) * (2.0 * np.pi / max(count, 1)) + rng.uniform(0.0, 2.0 * np.pi)
            elevations = np.radians(rng.uniform(18.0, 55.0, count))
            for i in range(count):
                eye = on_dome(radius, azimuths[i], elevations[i])
                views.append(View(len(views), i, float(moments[i]), camera(eye, i), split))
        return tuple(views)
    if options.rig == "arc":
        spread = np.radians(70.0)
        views = []
        for c in range(options.cameras):
            # camera 0, the test camera, stands in the middle of the arc; the others are spread evenly over it
            share = 0.5 if c == 0 else (c - 1) / max(options.cameras - 2, 1)
            eye = on_dome(radius, -0.5 * np.pi + spread * (share - 0.5), np.radians(28.0 + 8.0 * (c % 2)))
            for k, time in enumerate(times):
                views.append(View(c, k, float(time), camera(eye, c), "test" if c == 0 else "train"))
        return tuple(views)
    views = []
    for k, time in enumerate(times):
        azimuth = -0.5 * np.pi + np.radians(50.0) * (time - 0.5)
        eye = on_dome(radius, azimuth, np.radians(26.0 + 6.0 * np.sin(2.0 * np.pi * time)))
        views.append(View(0, k, float(time), camera(eye, k), "train"))
    return tuple(views)


def on_dome(radius: float, azimuth: float, elevation: float) -> np.ndarray:
    """[3]: a point on a dome around (0, 0, 0.35)."""
    flat = radius * np.cos(elevation)
    return np.array([flat * np.cos(azimuth), flat * np.sin(azimuth), 0.35 + radius * np.sin(elevation)])
