"""Scene and camera moved by up to 1e6 in float32.

World coordinates are then rounded to 2^-4 at 1e6: that is lost before the rasterizer sees it, and no renderer brings it back. What
is promised is that nothing more is lost: the kernels draw those rounded numbers as the float64 reference draws them. The test of
test_robustness.py moves float64 inputs, where the picture itself stays the same.
"""

import pytest
import torch
from rasterizer.compare import assert_images_close, decided_by_threshold
from rasterizer.kernels import needs_cpu
from rasterizer.scenes import F64, Scene, random_scene

from .against_reference import check

pytestmark = needs_cpu


def grown(seed: int, times: float) -> Scene:
    """A scene `times` as large, so that rounding of coordinates at 1e6 leaves its shapes recognisable."""
    scene = random_scene(seed, gaussians=25, convexes=12, degree=None, width=41, height=27)
    one = scene.tensors()
    pose = one["cam_from_world"].clone()
    pose[:3, 3] *= times
    changed = {name: one[name] * times for name in ("gaussians.means", "gaussians.scales", "convexes.points")}
    changed |= {name: one[name] / times for name in ("convexes.tau", "convexes.kappa")}
    return scene.having({**changed, "cam_from_world": pose})


def moved(scene: Scene, by: float) -> Scene:
    shift = torch.tensor([by, -0.5 * by, 0.25 * by], dtype=F64)
    pose = scene.camera.cam_from_world.clone()
    pose[:3, 3] -= pose[:3, :3] @ shift
    return scene.having({"cam_from_world": pose} | {name: scene.tensors()[name] + shift for name in ("gaussians.means", "convexes.points")})


@pytest.mark.parametrize("by", [1e3, 1e4, 1e5, 1e6])
def test_scene_and_camera_moved_by_1e6_in_float32(by: float) -> None:
    check(moved(grown(60, 64.0), by), max_decided=0.2)


@pytest.mark.parametrize("by", [1e4, 1e6])
def test_what_rounding_of_float32_inputs_costs_at_1e6(by: float) -> None:
    """Half a step of the coordinates, by, 2^-24, seen under this lens: that is how far pictures may drift from the unmoved one."""
    scene = grown(60, 64.0)
    there = moved(scene, by).to(torch.float32)
    drift = (there.render("cpu").color.double() - scene.render("reference").color).abs().mean()
    pixels = by * 2.0**-24 / (64.0 * 4) * float(scene.camera.K[0, 0])  # of the depth of the scene's middle
    assert 1e-7 < float(drift) < pixels


def test_a_scene_of_ordinary_size_at_1e4() -> None:
    """Not grown: its details are 1e-3, a step of the coordinates. Still drawn as given."""
    single = moved(random_scene(61, gaussians=25, convexes=12, degree=None), 1e4).to(torch.float32)
    assert_images_close(single.render("cpu"), single.render("reference"), decided_by_threshold(single), max_decided=0.2)
