"""Make the capture that the repository ships: `python tests/factory/make_sample.py [FOLDER]` (default: samples/cube_and_ball).

A checkered cube turns and slides while a striped ball hops over, on a tiled slab; D-NeRF layout. The result is a function of this
file and the factory alone, and tests/test_sample.py holds the shipped files to it.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

if __package__ in (None, ""):  # run as a script: tests/ holds the package `factory`
    sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from factory.camera import Camera, intrinsics, look_at
from factory.motion import Motion
from factory.scene import Object, Options, Scene, Split, Synthetic, View
from factory.shapes import Box, Sphere
from factory.textures import Checker, Stripes
from factory.writers import write_dnerf

SIZE = 160
COUNTS: dict[Split, int] = {"train": 48, "val": 4, "test": 8}
TARGET = np.array([0.0, 0.0, 0.18])
RADIUS = 4.0  # of the dome on which all cameras stand


def sample() -> Synthetic:
    """The scene and its 60 views. Nothing is random: cameras follow golden-angle spirals."""
    slab = Object("slab", Box((1.0, 1.0, 0.08)), Checker(0.5, (0.80, 0.78, 0.73), (0.50, 0.56, 0.60), tint=0.12), Motion((0.0, 0.0, -0.08)))
    cube_motion = Motion((-0.36, 0.1, 0.36), slide=(0.0, -0.3, 0.0), turn=0.6, rest_angle=0.25)
    cube = Object("cube", Box((0.36, 0.36, 0.36)), Checker(0.24, tint=0.5, shift=0.5), cube_motion)
    ball_motion = Motion((0.48, 0.0, 0.30), slide=(0.0, 0.35, 0.0), axis=(1.0, 0.0, 0.0), turn=-0.5, bounce=0.35, bounces=1)
    ball = Object("ball", Sphere(0.30), Stripes(0.19, ((0.88, 0.20, 0.14), (0.97, 0.94, 0.86))), ball_motion)
    scene = Scene((slab, cube, ball), light=0.45)

    views = []
    for split, count in COUNTS.items():
        for i, (azimuth, elevation) in enumerate(_spiral(split, count)):
            time = i / (count - 1) if split == "train" else (i + 0.5) / count
            flat = RADIUS * np.cos(elevation)
            eye = TARGET + np.array([flat * np.cos(azimuth), flat * np.sin(azimuth), RADIUS * np.sin(elevation)])
            camera = Camera(intrinsics(SIZE, SIZE, 39.0), look_at(eye, TARGET), SIZE, SIZE)
            views.append(View(len(views), i, time, camera, split))
    return Synthetic(scene, tuple(views), Options(width=SIZE, height=SIZE, samples=6))


def _spiral(split: Split, count: int) -> list[tuple[float, float]]:
    """Azimuth and elevation (radians) of each view: even over the dome, and unrelated to its time."""
    golden = np.pi * (3.0 - np.sqrt(5.0))
    start = {"train": 0.0, "val": 0.9, "test": 1.7}[split]
    # sin(elevation) even in [sin 14, sin 62 degrees]; the stride, coprime to all counts, breaks the link with time
    low, high = np.sin(np.radians([14.0, 62.0]))
    ranks = [(i * 19 + 5) % count for i in range(count)]
    return [(start + golden * i, float(np.arcsin(low + (high - low) * (rank + 0.5) / count))) for i, rank in enumerate(ranks)]


def main(arguments: list[str]) -> None:
    folder = Path(arguments[0]) if arguments else Path(__file__).resolve().parents[2] / "samples" / "cube_and_ball"
    capture = write_dnerf(sample(), folder)
    size = sum(file.stat().st_size for file in folder.rglob("*") if file.is_file())
    print(f"{folder}: {len(capture.views)} views, {size / 1e6:.2f} MB")


if __name__ == "__main__":
    main(sys.argv[1:])
