"""Scenes to measure on: gsplat's garden scene if its file is given, otherwise synthetic ones. All random numbers come from a seed."""

from __future__ import annotations

import numpy as np
import torch

from ...pipeline import SettingsError
from ...rasterizer import Camera, Convexes, Gaussians
from ...rasterizer.reference.scene import Scene
from .rows import Bench

GARDEN_COUNT, GARDEN_SIZE = 138_766, (648, 420)
CONVEX_COUNT = 50_000
SEED = 42


def garden(bench: Bench) -> tuple[Scene, str]:
    """The scene of gsplat's benchmark, and its name.

    Means, colours and the first camera are from the file; quats are normal, scales uniform in [1e-4, 0.02] and opacities uniform, from
    default_rng(42). Without a file: `cloud` with the same number of Gaussians and pixels.
    """
    width, height = bench.size(*GARDEN_SIZE)
    if bench.garden is None:
        scene = cloud(bench.count(GARDEN_COUNT), width, height)
        return scene, f"synthetic, {len_of(scene):,} Gaussians, {width}x{height}"
    try:
        data = np.load(bench.garden, allow_pickle=False)
        means, colors, K, pose = data["means3d"], data["colors"] / 255, np.array(data["Ks"][0]), data["viewmats"][0]
        full = int(data["width"]), int(data["height"])
    except (OSError, ValueError, KeyError) as cause:
        raise SettingsError(f"--garden {bench.garden}: expected arrays means3d, colors, Ks, viewmats, width, height ({cause})") from cause
    rng = np.random.default_rng(SEED)
    n = len(means)
    quats, scales, opacities = rng.standard_normal((n, 4)), rng.uniform(1e-4, 0.02, (n, 3)), rng.uniform(0, 1, n)
    some = slice(None, None, max(1, round(1 / bench.scale)))
    width, height = bench.size(*full)
    K[0] *= width / full[0]
    K[1] *= height / full[1]
    camera = Camera(tensor(K), tensor(pose), width, height)
    parts = {"means": means, "quats": quats, "scales": scales, "opacities": opacities, "colors": colors}
    gaussians = Gaussians(**{name: tensor(part[some]) for name, part in parts.items()})
    return Scene(camera, gaussians, None, torch.zeros(3)), f"{bench.garden.name}, {len(gaussians.means):,} Gaussians, {width}x{height}"


def cloud(n: int, width: int, height: int, degree: int | None = None, size: float = 0.02) -> Scene:
    """``n`` Gaussians around a sphere of radius 1, seen from a distance of 4. Their median scale is ``size``, so pairs grow with n."""
    rng = np.random.default_rng(SEED)
    means = rng.standard_normal((n, 3))
    means /= np.linalg.norm(means, axis=1, keepdims=True) + 0.3 * rng.uniform(0, 1, (n, 1))
    scales = np.exp(rng.normal(np.log(size), 0.5, (n, 3)))
    quats, opacities = rng.standard_normal((n, 4)), rng.uniform(0.05, 1, n)
    looks = {"colors": tensor(rng.uniform(0, 1, (n, 3)))} if degree is None else {"sh": tensor(_sh(rng, n, degree))}
    return Scene(
        camera_of(width, height), Gaussians(tensor(means), tensor(quats), tensor(scales), tensor(opacities), **looks), None, torch.zeros(3)
    )


def convexes(m: int, width: int, height: int) -> Scene:
    """``m`` convexes of six points, scattered in front of the camera, each about 20 px across at 648x420."""
    rng = np.random.default_rng(SEED)
    points = 1.2 * rng.standard_normal((m, 1, 3)) + 0.03 * rng.standard_normal((m, 6, 3))
    tau, kappa = rng.uniform(50, 300, m), rng.uniform(100, 600, m)
    opacities, colors = rng.uniform(0.05, 1, m), rng.uniform(0, 1, (m, 3))
    shapes = Convexes(tensor(points), tensor(tau), tensor(kappa), tensor(opacities), colors=tensor(colors))
    return Scene(camera_of(width, height), None, shapes, torch.zeros(3))


def mixed(n: int, width: int, height: int, extras: int = 0) -> Scene:
    """Half Gaussians with SH, half convexes, in one image."""
    both = cloud(max(1, n // 2), width, height, degree=2)
    both.convexes = convexes(max(1, n - n // 2), width, height).convexes
    if extras:
        rng = np.random.default_rng(SEED + 1)
        for owner in (both.gaussians, both.convexes):
            assert owner is not None
            owner.extras = tensor(rng.standard_normal((len(owner.opacities), extras)))
    return both


def camera_of(width: int, height: int) -> Camera:
    """A camera that looks at the origin from a distance of 4; the width spans 45 degrees."""
    K = torch.tensor([[1.2 * width, 0, width / 2], [0, 1.2 * width, height / 2], [0, 0, 1]])
    pose = torch.eye(4)
    pose[2, 3] = 4.0
    return Camera(K, pose, width, height)


def len_of(scene: Scene) -> int:
    """Number of primitives of both kinds."""
    return sum(len(owner.opacities) for owner in (scene.gaussians, scene.convexes) if owner is not None)


def tensor(array: np.ndarray) -> torch.Tensor:
    return torch.from_numpy(np.ascontiguousarray(array, dtype=np.float32))


def _sh(rng: np.random.Generator, n: int, degree: int) -> np.ndarray:
    """Coefficients [n, (degree+1)^2, 3] whose bands decrease as in a reconstruction."""
    band = np.sqrt(np.arange((degree + 1) ** 2)).astype(int)
    return 0.3 / (1 + band[None, :, None]) ** 2 * rng.standard_normal((n, (degree + 1) ** 2, 3))
