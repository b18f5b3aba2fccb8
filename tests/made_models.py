"""Small models of every motion, of random Gaussians and convexes, made without training."""

import math

import numpy as np
import torch
from e4dgs.rasterizer import Camera
from e4dgs.scene.fibonacci import fibonacci_sphere
from e4dgs.scene.model import Model
from e4dgs.scene.motion.lifetimes.lifetimes import Lifetimes
from e4dgs.scene.motion.nodes.control_nodes import ControlNodes
from e4dgs.scene.motion.nodes.rigid_parts import RigidParts
from e4dgs.scene.motion.planes.field import DeformationField
from e4dgs.scene.motion.static import Static
from e4dgs.scene.primitives import ConvexSet, GaussianSet

FRAMES = 12
MOTIONS = ("static", "lives", "nodes", "planes")


def made(motion: str, degree: int = 2, gaussians: int = 500, convexes: int = 60, antialiased: bool = True, near: float = 0.05) -> Model:
    """Half of the primitives move, except if ``motion`` is static. The scene lies within about 1.2 of the origin."""
    rng = np.random.default_rng(3)
    places = rng.uniform(-0.9, 0.9, (gaussians, 3)).astype(np.float32)
    some = GaussianSet.from_points(places, rng.uniform(0, 1, (gaussians, 3)), degree, opacity=0.7, max_scale=0.08)
    centres, size = rng.uniform(-0.8, 0.8, (convexes, 1, 3)), rng.uniform(0.05, 0.25, (convexes, 1, 1))
    points = centres + size * fibonacci_sphere(6) * rng.uniform(0.4, 1.2, (convexes, 6, 1))
    others = ConvexSet.from_points(points.astype(np.float32), rng.uniform(0, 1, (convexes, 3)), degree, opacity=0.85)
    everything = ControlNodes.attributes | Lifetimes.attributes  # the model keeps what its motion needs
    some, others = some.carrying(everything), others.carrying(everything)
    with torch.no_grad():
        for one in (some, others):
            numbers = torch.Generator().manual_seed(len(one))

            def noise(of, by, numbers=numbers):
                return by * torch.randn(of.shape, generator=numbers)

            one.sh_rest.copy_(noise(one.sh_rest, 0.15))
            one.shades.copy_(noise(one.shades, 0.3))
            one.hyper.copy_(noise(one.hyper, 0.02))
            one.opacity_logits.add_(noise(one.opacity_logits, 1.0))
            one.dynamic[:] = torch.arange(len(one)) % 2 == 0 if motion != "static" else False
            if motion == "lives":
                one.times.copy_(FRAMES * torch.rand(len(one), generator=numbers))
                one.log_spans.copy_(torch.log(1 + 5 * torch.rand(len(one), generator=numbers)))
                one.log_spans[::6] = math.log(1e4)
                one.velocities.copy_(noise(one.velocities, 0.03))
                one.spins.copy_(noise(one.spins, 0.15))
        some.quats.copy_(torch.randn(some.quats.shape, generator=torch.Generator().manual_seed(1)))
        some.log_scales.add_(0.6 * torch.randn(some.log_scales.shape, generator=torch.Generator().manual_seed(2)))
    field = {"static": Static, "lives": lambda: Lifetimes(FRAMES), "nodes": nodes, "planes": planes}[motion]()
    return Model(some, others, field, degree, near, (1.0, 0.9, 0.8), antialiased=antialiased)


def nodes() -> ControlNodes:
    """Forty nodes that move by about a fifth of the scene, and a rigid part that turns once."""
    home = torch.rand(40, 3, generator=torch.Generator().manual_seed(5)) * 2 - 1
    angle = torch.linspace(0, math.pi, FRAMES)[:, None]
    turns = torch.cat([torch.cos(angle), torch.zeros(FRAMES, 2), torch.sin(angle)], 1)[:, None]
    part = RigidParts(torch.tensor([[0.6, 0.6, 0.0]]), torch.tensor([0.4]), turns, torch.zeros(FRAMES, 1, 3))
    found = ControlNodes(home, torch.zeros(3), 1.0, 0.5, seed=2, rigid_parts=part)
    with torch.no_grad():
        found.network.place[-1].weight.normal_(0.0, 0.1, generator=torch.Generator().manual_seed(6))
        found.network.time[0].weight[:, [3, 4, 5, 6, 9, 10, 11, 12]] = 0  # slow courses: without the highest four octaves
    return found


def planes() -> DeformationField:
    found = DeformationField(torch.full((3,), -1.1), torch.full((3,), 1.1), FRAMES, (8,), channels=8, width=32, seed=1)
    with torch.no_grad():
        found.head.weight.normal_(0.0, 0.03, generator=torch.Generator().manual_seed(7))
        for plane in found.planes.time:
            plane.add_(0.15 * torch.randn(plane.shape, generator=torch.Generator().manual_seed(8)))
    return found


def camera(angle: float, width: int = 160, height: int = 120, distance: float = 3.0, focal: float = 150.0) -> Camera:
    """Looks at the origin from ``angle`` (rad) about the world's y, with unequal focal lengths and an off-centre principal point."""
    s, c = math.sin(angle), math.cos(angle)
    pose = torch.tensor([[c, 0, -s, 0.05], [0.1 * s, 0.995, 0.1 * c, -0.1], [s, -0.1, c, distance], [0, 0, 0, 1.0]])
    left, _, right = torch.linalg.svd(pose[:3, :3])
    pose[:3, :3] = left @ right
    lens = torch.tensor([[focal, 0, 0.52 * width], [0, 1.04 * focal, 0.47 * height], [0, 0, 1.0]])
    return Camera(lens, pose, width, height)
