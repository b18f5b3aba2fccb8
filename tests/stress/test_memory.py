"""Memory for footprints of a million pixels: it grows with pixels and (tile, primitive) pairs, never with (pixel, primitive) pairs."""

import os
import subprocess
import sys

import pytest
from rasterizer.kernels import needs_cpu

SCRIPT = """
import resource, sys, torch
from e4dgs.rasterizer import Camera, Convexes, Gaussians, rasterize

torch.set_num_threads(2)
count, size = int(sys.argv[1]), int(sys.argv[2])

def render(n, side):
    K = torch.tensor([[side, 0.0, side / 2], [0, side, side / 2], [0, 0, 1]])
    g = torch.Generator().manual_seed(0)
    z = torch.linspace(1, 2, n)
    means = torch.stack([0 * z, 0 * z, z], 1)
    quats = torch.tensor([[1.0, 0, 0, 0]]).repeat(n, 1)
    gaussians = Gaussians(means, quats, torch.full((n, 3), 100.0), torch.full((n,), 0.02), colors=torch.rand(n, 3, generator=g))
    points = torch.tensor([[-300.0, -300, 0], [300, -300, 0], [0, 300, 0]]) + means[:, None]
    convexes = Convexes(points, torch.ones(n), torch.ones(n), torch.full((n,), 0.02), colors=torch.rand(n, 3, generator=g))
    for owner, names in ((gaussians, ("means", "quats", "scales", "opacities", "colors")), (convexes, ("points", "tau", "kappa"))):
        for name in names:
            getattr(owner, name).requires_grad_()
    frame = rasterize(Camera(K, torch.eye(4), side, side), gaussians, convexes)
    (frame.color.sum() + frame.depth.sum()).backward()
    for seen in (frame.visible_gaussians, frame.visible_convexes):
        assert bool(seen[:20].all())
    assert float(frame.alpha.detach().min()) > 0.1 and bool(gaussians.colors.grad[:20].any())

render(4, 64)
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
render(count, size)
print((resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024)
"""


@needs_cpu
@pytest.mark.skipif("E4DGS_SANITIZED" in os.environ, reason="the address sanitizer has memory of its own")
@pytest.mark.parametrize(
    ("count", "size", "megabytes"),
    [
        (1000, 48, 10),  # footprints of far more than 1e6 px on an image of 9 tiles
        (
            25,
            1000,
            110,
        ),  # 50 footprints of 1e6 px: 50 x 3969 pairs of some 100 bytes, and images; a float a pixel pair would be 200 MB
    ],
)
def test_a_footprint_of_1e6_px_in_bounded_memory(count: int, size: int, megabytes: float) -> None:
    command = [sys.executable, "-c", SCRIPT, str(count), str(size)]
    result = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert result.returncode == 0, result.stderr
    grown = float(result.stdout)
    assert grown < megabytes, f"{grown:.0f} MB"
