"""Gaussians whose rotation or covariance is badly conditioned."""

from dataclasses import replace

import pytest
import torch
from e4dgs.rasterizer import Camera, Gaussians
from rasterizer.compare import assert_images_close, cotangents, decided_by_threshold, gradients
from rasterizer.kernels import needs_cpu
from rasterizer.scenes import F64, Scene, generator, make_camera, needles, random_scene, uniform

from .against_reference import IMAGE, check, check_gradients

pytestmark = needs_cpu


@pytest.mark.parametrize("norm", [1e-30, 1e-12, 1e12, 1e30])
def test_quaternions_of_any_norm_have_the_gradients_of_the_reference(norm: float) -> None:
    scene = random_scene(20, gaussians=15, degree=1)
    quats = scene.tensors()["gaussians.quats"]
    check(scene.having({"gaussians.quats": quats * (norm / quats.norm(dim=1, keepdim=True))}))


@pytest.mark.parametrize("component", range(4))
def test_quaternions_whose_components_differ_by_1e30(component: int) -> None:
    """Squares of the small ones are below float32's range: they must count as zero, not as NaN."""
    scene = random_scene(21, gaussians=15, degree=0)
    quats = 1e-30 * scene.tensors()["gaussians.quats"]
    quats[:, component] = 1.0
    check(scene.having({"gaussians.quats": quats}))


@pytest.mark.parametrize("antialiased", [False, True])
@pytest.mark.parametrize("seed", range(3))
def test_needles_and_plates_of_1e_6_to_1(instruction_set: str, seed: int, antialiased: bool) -> None:
    check(replace(needles(seed, n=24), antialiased=antialiased))


def test_compensation_of_scales_over_six_decades() -> None:
    """From all of the opacity to none of it: what a threshold does not decide has image and gradients of the reference."""
    scene = random_scene(23, gaussians=60, degree=0, antialiased=True)
    scales = torch.exp(uniform(generator(3), -11.0, 1.0, 60, 3))
    frame = check(scene.having({"gaussians.scales": scales}))
    assert 10 < int(frame.visible_gaussians.sum()) < 50


def test_a_needle_through_many_tiles() -> None:
    """70 px long and, without the 0.3 px^2 of dilation, 1e-5 px wide, in every direction: no pixel of it is lost between tiles."""
    n = 16
    camera = make_camera(75, 60)
    camera.cam_from_world[:3, :3] = torch.eye(3)
    angle = torch.linspace(0, torch.pi, n + 1, dtype=F64)[:-1]
    zero = torch.zeros(n, dtype=F64)
    gaussians = Gaussians(
        means=torch.stack([zero, zero, torch.linspace(-0.5, 0.5, n, dtype=F64)], 1),
        quats=torch.stack([(angle / 2).cos(), zero, zero, (angle / 2).sin()], 1),
        scales=torch.tensor([1.0, 1e-6, 1e-6], dtype=F64).repeat(n, 1),
        opacities=torch.full((n,), 0.9, dtype=F64),
        colors=uniform(generator(1), 0, 1, n, 3),
    )
    frame = check(Scene(camera, gaussians, None, torch.zeros(3, dtype=F64)))
    assert int((frame.alpha > 0.1).sum()) > 700


@pytest.mark.parametrize("scale", [1e-10, 1e-20, 1e-36])
def test_determinant_ratios_that_underflow(scale: float) -> None:
    """A point: the determinant of its covariance is 0 in float32, and so is its ratio to the dilated one. It is a dot of 0.3 px^2."""
    scene = random_scene(22, gaussians=25, degree=1)
    small = scale * torch.tensor([1.0, 2.0, 3.0], dtype=F64).repeat(25, 1)
    single = scene.having({"gaussians.scales": small}).to(torch.float32)
    got, want, decided = single.render("cpu"), single.render("reference"), decided_by_threshold(single)
    assert_images_close(got, want, decided, tolerance=IMAGE)
    assert bool(got.visible_gaussians.any())
    # The gradient of quats is of the order of scale^2: at 1e-20 there is no such number in float32.
    names = tuple(name for name in single.tensors() if name != "gaussians.quats" or scale > 1e-15)
    check_gradients(single, cotangents(want, ignore=decided), names)


@pytest.mark.parametrize("scale", [1e3, 1e5, 1e8])
def test_determinants_that_are_huge(scale: float) -> None:
    """Wider than any image: alpha is the opacity everywhere."""
    camera = make_camera()
    means = torch.tensor([[0.0, 0, 0], [0.3, 0.1, 0.5]], dtype=F64)
    gaussians = Gaussians(
        means, torch.eye(4, dtype=F64)[:2], torch.full((2, 3), scale, dtype=F64), torch.tensor([0.5, 0.7], dtype=F64),
        colors=torch.eye(3, dtype=F64)[:2],
    )  # fmt: skip
    single = Scene(camera, gaussians, None, torch.zeros(3, dtype=F64)).to(torch.float32)
    got = single.render("cpu")
    assert_images_close(got, single.render("reference"), decided_by_threshold(single))
    assert torch.allclose(got.alpha, torch.tensor(0.85), atol=1e-4)


def test_a_far_gaussian_under_a_long_lens() -> None:
    """Depths of 1e4 and a focal length of 1e6 px: the Jacobian's entries and the covariance differ by many orders."""
    n = 12
    K = torch.tensor([[1e6, 0, 20.0], [0, 1.1e6, 15.0], [0, 0, 1]], dtype=F64)
    g = generator(2)
    means = torch.cat([uniform(g, -0.15, 0.15, n, 2), uniform(g, 9e3, 1e4, n, 1)], 1)
    gaussians = Gaussians(
        means, torch.randn(n, 4, generator=g, dtype=F64), uniform(g, 1e-3, 0.1, n, 3), uniform(g, 0.3, 0.95, n),
        colors=uniform(g, 0, 1, n, 3),
    )  # fmt: skip
    frame = check(Scene(Camera(K, torch.eye(4, dtype=F64), 41, 29), gaussians, None, torch.zeros(3, dtype=F64)))
    assert int(frame.visible_gaussians.sum()) > 6


@pytest.mark.parametrize("z", [2.0, 300.0])
def test_depth_of_one_faint_layer_pulls_at_nothing_but_its_place(instruction_set: str, z: float) -> None:
    """Depth is a mean, over an alpha of 0.02 and less here: of one layer it is that layer's z, whatever its alpha. Taken as a difference
    of two large terms, a gradient of rounding over alpha would be left."""
    gaussians = Gaussians(
        means=torch.tensor([[0.0, 0.0, z]]),
        quats=torch.tensor([[1.0, 0.0, 0.0, 0.0]]),
        scales=torch.full((1, 3), 0.1 * z),
        opacities=torch.tensor([0.02]),
        colors=torch.zeros(1, 3),
    )
    camera = make_camera(40, 30)
    camera.cam_from_world[:3] = torch.eye(4)[:3]
    scene = Scene(camera, gaussians, None, torch.zeros(3)).to(torch.float32)
    frame = scene.render("cpu")
    assert int((frame.alpha > 0).sum()) > 100
    assert torch.equal(frame.depth[frame.alpha > 0], torch.tensor(z).expand(int((frame.alpha > 0).sum())))
    found = gradients(scene, "cpu", cotangents(frame, outputs=("depth",)))
    assert float(found["gaussians.opacities"].abs()) <= 1e-9 * z and float(found["gaussians.scales"].abs().max()) <= 1e-9
    assert float(found["gaussians.means"][0, 2]) != 0
