"""Time the CPU rasterizer: `python benchmarks/raster_speed.py [--scene garden|cloud|convexes] [--threads N] [--kernels NAME]`.

garden: gsplat's benchmark scene (bench/test_garden.npz beside the repository, 138,766 Gaussians, first camera, 648x420), with
    quats normal, scales uniform in [1e-4, 0.02], opacities uniform from default_rng(42).
cloud: 15,000 synthetic Gaussians with SH of degree 3 at 400x400, the size of a training step.
convexes: 50,000 synthetic convexes of six points at 648x420.

Prints the best of `--repeats` runs of forward alone and of forward + backward, in ms and in ns a pair, where a pair is a pixel and
a primitive with alpha >= 1/255 there; "blended" pairs come before their pixel stops.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np
import torch
from e4dgs.rasterizer import Camera, Convexes, Gaussians, _cpu, cpu_backend

GARDEN = Path(__file__).resolve().parents[2] / "shared" / "bench" / "test_garden.npz"


def tensor(array: np.ndarray) -> torch.Tensor:
    return torch.from_numpy(np.ascontiguousarray(array, dtype=np.float32))


def garden() -> tuple[Camera, Gaussians | None, Convexes | None]:
    data = np.load(GARDEN, allow_pickle=False)
    rng = np.random.default_rng(42)
    n = len(data["means3d"])
    quats, scales, opacities = rng.standard_normal((n, 4)), rng.uniform(1e-4, 0.02, (n, 3)), rng.uniform(0, 1, n)
    camera = Camera(tensor(data["Ks"][0]), tensor(data["viewmats"][0]), int(data["width"]), int(data["height"]))
    return camera, Gaussians(*map(tensor, (data["means3d"], quats, scales, opacities)), colors=tensor(data["colors"] / 255)), None


def synthetic_camera(width: int, height: int) -> Camera:
    K = torch.tensor([[1.2 * width, 0, width / 2], [0, 1.2 * width, height / 2], [0, 0, 1]])
    pose = torch.eye(4)
    pose[2, 3] = 4.0
    return Camera(K, pose, width, height)


def cloud() -> tuple[Camera, Gaussians | None, Convexes | None]:
    rng = np.random.default_rng(42)
    n = 15_000
    means = rng.standard_normal((n, 3))
    means /= np.linalg.norm(means, axis=1, keepdims=True) + 0.3 * rng.uniform(0, 1, (n, 1))
    scales = np.exp(rng.normal(np.log(0.02), 0.5, (n, 3)))
    sh = 0.3 * rng.standard_normal((n, 16, 3))
    parts = map(tensor, (means, rng.standard_normal((n, 4)), scales, rng.uniform(0.05, 1, n)))
    return synthetic_camera(400, 400), Gaussians(*parts, sh=tensor(sh)), None


def convexes() -> tuple[Camera, Gaussians | None, Convexes | None]:
    rng = np.random.default_rng(42)
    m = 50_000
    points = 1.2 * rng.standard_normal((m, 1, 3)) + 0.03 * rng.standard_normal((m, 6, 3))
    tau, kappa = rng.uniform(50, 300, m), rng.uniform(100, 600, m)
    shapes = Convexes(*map(tensor, (points, tau, kappa, rng.uniform(0.05, 1, m))), colors=tensor(rng.uniform(0, 1, (m, 3))))
    return synthetic_camera(648, 420), None, shapes


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", choices=("garden", "cloud", "convexes"), default="garden")
    parser.add_argument("--threads", type=int, default=torch.get_num_threads())
    parser.add_argument("--kernels", default=None, help="avx512, avx2 or baseline; the best by default")
    parser.add_argument("--repeats", type=int, default=15)
    arguments = parser.parse_args()
    if arguments.kernels and not _cpu.select_kernels(arguments.kernels):
        raise SystemExit(f"this processor or build has no kernels {arguments.kernels!r}")
    torch.set_num_threads(arguments.threads)

    from e4dgs.rasterizer.rasterize import _empty_convexes, _empty_gaussians, _pad_extras

    camera, gaussians, shapes = {"garden": garden, "cloud": cloud, "convexes": convexes}[arguments.scene]()
    gaussians, shapes = _pad_extras(gaussians or _empty_gaussians(camera), shapes or _empty_convexes(camera))
    leaves = [v for owner in (gaussians, shapes) for name, v in vars(owner).items() if v is not None and name != "extras"]
    background = torch.zeros(3)

    def forward() -> tuple[torch.Tensor, torch.Tensor]:
        frame = cpu_backend.rasterize_cpu(camera, gaussians, shapes, background)
        return frame.color, frame.alpha

    forward_s = min(timed(forward) for _ in range(arguments.repeats))
    for leaf in leaves:
        leaf.requires_grad_(True)
    color, _ = forward()
    assert color.grad_fn is not None
    visible, blended = _cpu.count_pairs(color.grad_fn.kept, arguments.threads)  # type: ignore[attr-defined]
    entries = color.grad_fn.kept.entries  # type: ignore[attr-defined]
    ones = torch.ones_like(color)

    def both() -> None:
        torch.autograd.grad(forward()[0], leaves, ones, allow_unused=True)

    both_s = min(timed(both) for _ in range(arguments.repeats))
    print(f"{arguments.scene}: {camera.width}x{camera.height}, {arguments.threads} threads, {_cpu.kernels()} kernels")
    print(f"pairs {visible / 1e6:.1f} M, blended {blended / 1e6:.1f} M, (tile, primitive) {entries / 1e6:.2f} M")
    for name, seconds in (("forward", forward_s), ("forward + backward", both_s), ("backward", both_s - forward_s)):
        each = [1e9 * seconds / count for count in (visible, blended)]
        print(f"{name:20} {1e3 * seconds:8.1f} ms   {each[0]:6.2f} ns a pair   {each[1]:6.2f} ns a blended pair")


def timed(function) -> float:
    start = time.perf_counter()
    function()
    return time.perf_counter() - start


if __name__ == "__main__":
    main()
