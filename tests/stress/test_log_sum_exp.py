"""The smooth maximum over edges where its arguments leave the range of exp, and where 0 meets infinity."""

import math

import pytest
import torch
from rasterizer.compare import OUTPUTS, assert_images_close, cotangents, decided_by_threshold, gradients
from rasterizer.kernels import needs_cpu
from rasterizer.scenes import Scene, one_convex, prism, random_scene

from .against_reference import IMAGE, check, check_gradients
from .test_hulls import several

pytestmark = needs_cpu

PENTAGON = [[-0.5, -0.4], [0.5, -0.45], [0.6, 0.2], [0.1, 0.5], [-0.55, 0.3]]


def sharp(tau: float, kappa: float) -> Scene:
    """Six pentagons, `several` of test_hulls, of this sharpness."""
    scene = several(PENTAGON)
    assert scene.convexes is not None
    scene.convexes.tau[:], scene.convexes.kappa[:] = tau, kappa
    return scene.to(torch.float32)


@pytest.mark.parametrize("kappa", [1.0, 20.0])
@pytest.mark.parametrize("tau", [1e3, 1e4, 1e5])
def test_arguments_of_1e4_have_the_image_and_gradients_of_the_reference(instruction_set: str, tau: float, kappa: float) -> None:
    """tau H of up to 1e5 on both sides of an edge: exp would be 0 and infinity. All gradients but that of tau itself."""
    single = sharp(tau, kappa)
    want, decided = single.render("reference"), decided_by_threshold(single)
    assert_images_close(single.render("cpu"), want, decided, tolerance=IMAGE)
    check_gradients(single, cotangents(want, ignore=decided), tuple(n for n in single.tensors() if n != "convexes.tau"))


@pytest.mark.parametrize("tau", [10.0, 100.0])
def test_the_gradient_of_tau(tau: float) -> None:
    check(sharp(tau, 20.0))


@pytest.mark.parametrize("tau", [1e4, 1e5])
def test_the_gradient_of_tau_at_arguments_of_1e4(tau: float) -> None:
    """Both sum_i p_i L_i and lse are tau H times larger than their difference, which is what tau's gradient consists of."""
    check(sharp(tau, 20.0))


EXTREMES = [1e-30, 1e-10, 1e-3, 1.0, 1e3, 1e10, 1e30]


@pytest.mark.parametrize("tau", EXTREMES)
def test_zero_times_infinity_in_tau_and_kappa(tau: float) -> None:
    """kappa / tau from 1e-60 to 1e60 times a maximum from -1e30 to 1e30: whatever is drawn is finite, and so is every gradient."""
    for kappa in EXTREMES:
        scene = one_convex(prism(PENTAGON), tau=tau, kappa=kappa).to(torch.float32)
        frame = scene.render("cpu")
        for output in OUTPUTS:
            assert bool(torch.isfinite(getattr(frame, output)).all()), (kappa, output)
        for name, gradient in gradients(scene, "cpu", {"color": torch.ones_like(frame.color)}).items():
            assert bool(torch.isfinite(gradient).all()), (kappa, name)


@pytest.mark.parametrize("tau", [1e-3, 1.0, 1e3, 1e6])
@pytest.mark.parametrize("kappa", [1e-3, 1.0, 1e3, 1e6])
def test_soft_and_sharp_images_agree_over_nine_decades(tau: float, kappa: float) -> None:
    scene = one_convex(prism(PENTAGON), tau=tau, kappa=kappa, opacity=0.8, width=33, height=21).to(torch.float32)
    decided = decided_by_threshold(scene)
    assert_images_close(scene.render("cpu"), scene.render("reference"), decided, tolerance=IMAGE, max_decided=0.2)


def test_far_outside_an_edge_nothing_is_left_and_far_inside_the_opacity() -> None:
    scene = one_convex(prism(PENTAGON), tau=1e6, kappa=1e6, opacity=0.8).to(torch.float32)
    alpha = scene.render("cpu").alpha
    u, v = (int(x) for x in scene.camera.K[:2, 2])
    assert math.isclose(float(alpha[v, u]), 0.8, rel_tol=1e-6)
    assert float(alpha[0, 0]) == 0 and float(alpha[-1, -1]) == 0


def test_sharp_convexes_in_a_crowd(instruction_set: str) -> None:
    """Every convex of its own sharpness, from a fog to a knife's edge."""
    scene: Scene = random_scene(30, convexes=24, degree=0)
    assert scene.convexes is not None
    scene.convexes.tau[:] = torch.logspace(-1, 4, 24)
    scene.convexes.kappa[:] = torch.logspace(3, -1, 24)
    check(scene)
