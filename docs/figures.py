"""Draws the figures of docs/maths.md with the product's own code: `python docs/figures.py`; `--check` compares them with the files."""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import matplotlib
import numpy as np
import torch
from e4dgs.rasterizer import Camera, Convexes, Gaussians, rasterize
from e4dgs.scene.fibonacci import fibonacci_sphere
from e4dgs.scene.motion.lifetimes.at_frame import at_frame
from e4dgs.scene.motion.lifetimes.lifetime import Lifetime
from e4dgs.scene.motion.lifetimes.lifetimes import Lifetimes

matplotlib.use("Agg")
import matplotlib.pyplot as plt
from mpl_toolkits.mplot3d.art3d import Poly3DCollection
from PIL import Image
from scipy.spatial import ConvexHull

FOLDER = Path(__file__).parent / "figures"
SIZE = 240  # px
WHITE = torch.ones(3)
CLOSE = 0.5  # levels of 8 bits in the mean; fonts and antialiasing differ between machines by less


def camera() -> Camera:
    K = torch.tensor([[300.0, 0, SIZE / 2], [0, 300.0, SIZE / 2], [0, 0, 1]])
    pose = torch.eye(4)
    pose[2, 3] = 4.0
    return Camera(K, pose, SIZE, SIZE)


def one(value: float) -> torch.Tensor:
    return torch.tensor([value])


def convex(points: np.ndarray, tau: float, kappa: float) -> torch.Tensor:
    """Alpha [H, W] of one opaque convex."""
    corners = torch.tensor(points[None], dtype=torch.float32)
    convex = Convexes(corners, one(tau), one(kappa), one(0.99), colors=torch.zeros(1, 3))
    return rasterize(camera(), convexes=convex, background=WHITE).alpha


def convexes() -> plt.Figure:
    """One convex of six points: kappa makes its border soft or sharp, tau rounds its corners; a Gaussian for comparison."""
    points = 1.1 * fibonacci_sphere(6)
    quats = torch.tensor([[1.0, 0, 0, 0]])
    ball = Gaussians(torch.zeros(1, 3), quats, torch.full((1, 3), 0.5), one(0.99), colors=torch.zeros(1, 3))
    shown = [("a Gaussian", rasterize(camera(), gaussians=ball, background=WHITE).alpha)]
    for tau, kappa in ((20.0, 4.0), (20.0, 20.0), (20.0, 200.0), (4.0, 200.0)):
        shown.append((f"τ = {tau:g}, κ = {kappa:g}", convex(points, tau, kappa)))
    figure, axes = plt.subplots(1, len(shown), figsize=(2.2 * len(shown), 2.6))
    for axis, (title, alpha) in zip(axes, shown):
        axis.imshow(alpha, cmap="gray_r", vmin=0, vmax=1)
        axis.set_title(title, fontsize=10)
        axis.axis("off")
    return figure


def spheres() -> plt.Figure:
    """The initial shapes of convexes of four, six and eight points, and how many points would lie."""
    figure = plt.figure(figsize=(9, 2.6))
    for k, count in enumerate((4, 6, 8, 200), 1):
        axis = figure.add_subplot(1, 4, k, projection="3d")
        points = fibonacci_sphere(count)
        axis.scatter(*points.T, s=40 if count < 10 else 6, color="#204080", depthshade=False)
        if count < 10:
            faces = points[ConvexHull(points).simplices]
            axis.add_collection3d(Poly3DCollection(faces, facecolor="#6090d0", edgecolor="#204080", alpha=0.35))
        axis.set_title(f"K = {count}" if count < 10 else f"{count} points", fontsize=10)
        axis.set_box_aspect((1, 1, 1))
        axis.axis("off")
    return figure


def lives() -> plt.Figure:
    """Opacity and place of three primitives with lives of their own."""
    times = 60
    motion = Lifetimes(times)
    life = Lifetime(
        torch.tensor([10.0, 30.0, 45.0]),
        torch.log(torch.tensor([6.0, 10.0, 5.0])),
        torch.tensor([[0.02, 0, 0], [-0.01, 0, 0], [0.03, 0, 0]]),
        torch.zeros(3, 3),
    )
    points, whole, dynamic = torch.zeros(3, 1, 3), torch.ones(3), torch.ones(3, dtype=torch.bool)
    moments = np.linspace(0, 1, 200)
    alive = [at_frame(points, None, whole, life, dynamic, motion.frame(float(t))) for t in moments]
    figure, (upper, lower) = plt.subplots(2, 1, figsize=(7, 3.6), sharex=True)
    frames = moments * (times - 1)
    for i in range(3):
        presence = np.array([float(shown[i]) for _, _, shown in alive])
        there = np.where(presence > 0.02, [float(moved[i, 0, 0]) for moved, _, _ in alive], np.nan)
        upper.plot(frames, presence)
        lower.plot(frames, there)
    upper.set_ylabel("share of opacity"), lower.set_ylabel("x, world units"), lower.set_xlabel("frame")
    return figure


def draw(folder: Path) -> None:
    folder.mkdir(exist_ok=True)
    for make in FIGURES:
        figure = make()
        figure.tight_layout()
        figure.savefig(folder / f"{make.__name__}.png", dpi=110, metadata={"Software": None})
        plt.close(figure)


def stale() -> list[str]:
    """The files of `FOLDER` that do not show what the code draws."""
    with tempfile.TemporaryDirectory() as scratch:
        draw(Path(scratch))
        fresh = {path.name: pixels(path) for path in Path(scratch).iterdir()}
    kept = {path.name: pixels(path) for path in FOLDER.iterdir()}
    return sorted(name for name in fresh.keys() | kept.keys() if not same(fresh.get(name), kept.get(name)))


def pixels(path: Path) -> np.ndarray:
    return np.asarray(Image.open(path).convert("RGB"), np.float32)


def same(a: np.ndarray | None, b: np.ndarray | None) -> bool:
    return a is not None and b is not None and a.shape == b.shape and float(np.abs(a - b).mean()) <= CLOSE


FIGURES = (convexes, spheres, lives)

if __name__ == "__main__":
    if sys.argv[1:] == ["--check"]:
        if names := stale():
            sys.exit(f"docs/figures/{names[0]}: not what the code draws; run python docs/figures.py")
    else:
        draw(FOLDER)
