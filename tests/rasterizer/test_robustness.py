"""What users of this field reported as NaN, corruption or crashes. Every case for the reference and for all kernels."""

import math
from collections.abc import Callable, Iterator

import pytest
import torch
from e4dgs.rasterizer import Frame
from torch import Tensor

from .compare import OUTPUTS, assert_images_close, decided_by_threshold, gradients
from .scenes import F64, Scene, needles, one_convex, prism, random_scene, stack, through_the_camera


def prepared(scene: Scene, backend: str) -> Scene:
    return scene if backend == "reference" else scene.to(torch.float32)


def ones(frame: Frame) -> dict[str, Tensor]:
    return {name: torch.ones_like(getattr(frame, name)) for name in OUTPUTS}


def assert_finite(scene: Scene, backend: str, outputs: tuple[str, ...] = OUTPUTS) -> tuple[Frame, dict[str, Tensor]]:
    """Render, and differentiate a loss on `outputs`; everything that comes out is finite."""
    frame = scene.render(backend)
    for output in OUTPUTS:
        assert bool(torch.isfinite(getattr(frame, output)).all()), output
    found = gradients(scene, backend, {name: weights for name, weights in ones(frame).items() if name in outputs})
    for name, gradient in found.items():
        assert bool(torch.isfinite(gradient).all()), f"gradient of {name}"
    return frame, found


@pytest.mark.parametrize("scale", [1e-30, 1e-12, 1e12, 1e30])
def test_tiny_and_huge_quaternions_are_rotations_like_any_other(backend: str, scale: float) -> None:
    scene = prepared(random_scene(0, gaussians=12, degree=1), backend)
    scaled = scene.having({"gaussians.quats": scene.tensors()["gaussians.quats"] * scale})
    frame, _ = assert_finite(scaled, backend)
    assert torch.allclose(frame.color, scene.render(backend).color, atol=1e-5)
    assert bool(frame.visible_gaussians.any())


def test_a_zero_quaternion_is_culled_alone(backend: str) -> None:
    scene = prepared(random_scene(0, gaussians=12, degree=1), backend)
    quats = scene.tensors()["gaussians.quats"].clone()
    quats[3] = 0
    frame, found = assert_finite(scene.having({"gaussians.quats": quats}), backend)
    assert not frame.visible_gaussians[3]
    assert not found["gaussians.means"][3].any()
    assert found["gaussians.means"].any()


def test_needles_are_finite(backend: str) -> None:
    frame, _ = assert_finite(prepared(needles(), backend), backend)
    assert bool(frame.visible_gaussians.any())


POISON = [float("nan"), float("inf"), float("-inf")]
FIELDS = ["means", "quats", "scales", "opacities", "sh", "extras"]
CONVEX_FIELDS = ["points", "tau", "kappa", "opacities", "sh", "extras"]


POISONED = [(f"gaussians.{f}", False) for f in FIELDS] + [(f"convexes.{f}", False) for f in CONVEX_FIELDS]
POISONED += [("gaussians.scales", True), ("convexes.points", True)]


@pytest.fixture
def sums_in_order() -> Iterator[None]:
    """Bit-identical sums on a GPU, too."""
    torch.use_deterministic_algorithms(True)
    yield
    torch.use_deterministic_algorithms(False)


@pytest.mark.usefixtures("sums_in_order")
@pytest.mark.parametrize(("name", "antialiased"), POISONED)
def test_one_poisoned_primitive_leaves_all_others_bit_identical(backend: str, name: str, antialiased: bool) -> None:
    kind = name.split(".")[0]
    options = {"gaussians": 30, "convexes": 15, "degree": 1, "extras": 2}
    scene = prepared(through_the_camera(1, **options) if antialiased else random_scene(1, **options), backend)
    tensors = scene.tensors()
    faint = tensors[f"{kind}.opacities"].clone()
    faint[4] = 0
    clean = scene.having({f"{kind}.opacities": faint})  # the same scene in which that primitive is simply invisible
    want, want_gradients = assert_finite(clean, backend)
    others = torch.arange(len(faint)) != 4

    def same(a: Tensor, b: Tensor) -> bool:
        # The reference sums over all survivors at once: one fewer may round differently in float64.
        return torch.equal(a, b) if backend != "reference" else torch.allclose(a, b, rtol=1e-10, atol=1e-12)

    for poison in POISON:
        value = tensors[name].clone()
        value[4].view(-1)[-1] = poison
        got, got_gradients = assert_finite(scene.having({name: value}), backend)
        for output in OUTPUTS:
            assert same(getattr(got, output), getattr(want, output)), f"{poison}: {output}"
        for field, gradient in got_gradients.items():
            expected = want_gradients[field]
            if field.startswith(kind):
                assert not gradient[4].any(), f"{poison}: {field}"
                gradient, expected = gradient[others], expected[others]
            assert same(gradient, expected), f"{poison}: {field}"


# Finite and in range, but extreme: whatever is drawn, nothing may become NaN.
EXTREMES = {
    "gaussians.means": [1e6, -1e6, 1e19, 3e38, -3e38, 1e-38],
    "gaussians.quats": [1e-38, 3e38],
    "gaussians.scales": [1e-38, 1e-20, 1e6, 1e19, 3e38],
    "gaussians.opacities": [1e-38, 1 / 255, 0.99, 1.0],
    "gaussians.sh": [1e30, -1e30],
    "convexes.points": [1e6, -1e6, 1e19, 3e38, -3e38, 1e-38],
    "convexes.tau": [1e-38, 1e-6, 1e6, 3e38],
    "convexes.kappa": [1e-38, 1e-6, 1e6, 3e38],
    "convexes.opacities": [1e-38, 1 / 255, 0.99, 1.0],
}


@pytest.mark.parametrize("antialiased", [False, True])
@pytest.mark.parametrize("name", EXTREMES.keys())
def test_extreme_values_give_finite_pictures_and_gradients(backend: str, name: str, antialiased: bool) -> None:
    scene = prepared(random_scene(2, gaussians=8, convexes=6, degree=1, antialiased=antialiased), backend)
    for value in EXTREMES[name]:
        tensor = scene.tensors()[name].clone()
        tensor[2].view(-1)[-1] = value
        # At the end of float32's range the depth is finite, but sums of its gradient are rightly beyond the range.
        outputs = OUTPUTS if abs(value) < 1e30 else ("color", "alpha", "extras")
        assert_finite(scene.having({name: tensor}), backend, outputs)
        tensor[2] = value
        assert_finite(scene.having({name: tensor}), backend, outputs)


def test_a_footprint_of_a_million_pixels(backend: str) -> None:
    """A Gaussian and a convex right in front of the camera cover far more than the image."""
    scene = random_scene(3, gaussians=4, convexes=4, degree=0)
    assert scene.gaussians is not None and scene.convexes is not None
    scene.camera.cam_from_world = torch.eye(4, dtype=F64)
    scene.gaussians.means[0] = torch.tensor([0.0, 0, 0.011])
    scene.gaussians.scales[0] = 100.0
    scene.convexes.points[0] = torch.tensor([[-300.0, -300, 0.02], [300, -300, 0.02], [0, 300, 0.02]]).repeat(2, 1)
    frame, _ = assert_finite(prepared(scene, backend), backend)
    assert bool(frame.visible_gaussians[0]) and bool(frame.visible_convexes[0])


def test_points_behind_the_camera_cull_the_convex_though_its_centroid_is_in_front(backend: str) -> None:
    scene = one_convex(prism([[-0.5, -0.4], [0.5, -0.4], [0.5, 0.4], [-0.5, 0.4]]))
    assert scene.convexes is not None
    for z, seen in ((-3.9, True), (-3.995, False), (-4.0, False), (-6.0, False)):  # depth 0.1, 0.005 < near, 0, -2
        scene.convexes.points[0, 0, 2] = z
        frame, found = assert_finite(prepared(scene, backend), backend)
        assert bool(frame.visible_convexes[0]) is seen, z
        assert bool(found["convexes.points"].any()) is seen, z


@pytest.mark.parametrize(("count", "opacity"), [(1000, 0.99), (1000, 1.0), (10_000, 0.004), (1000, 0.02), (1000, 0.3)])
def test_deep_stacks_against_the_closed_form(backend: str, count: int, opacity: float) -> None:
    """Every layer has this alpha at the one pixel: T = (1 - a)^n for the largest n that stays above the stop."""
    alpha = min(0.99, opacity)
    layers = min(count, math.floor(math.log(0.99e-4) / math.log1p(-alpha)))
    scene = prepared(stack(count, opacity), backend)
    frame, _ = assert_finite(scene, backend)
    assert math.isclose(float(frame.alpha), 1 - (1 - alpha) ** layers, abs_tol=2e-6)
    n = torch.arange(layers, dtype=F64)
    weights = alpha * (1 - alpha) ** n
    depths = torch.linspace(2.0, 6.0, count, dtype=F64)[:layers]
    assert math.isclose(float(frame.depth), float(weights @ depths / weights.sum()), rel_tol=1e-5)
    assert abs(int(frame.visible_gaussians.sum()) - layers) <= (0 if backend == "reference" else 1)


@pytest.mark.parametrize(("count", "opacity"), [(1000, 0.98), (10_000, 0.0041), (1000, 0.02)])
def test_deep_stacks_have_the_reference_s_gradients(kernels: str, count: int, opacity: float) -> None:
    from .compare import assert_gradients_close

    scene = stack(count, opacity).to(torch.float32)
    want = scene.render("reference")
    assert_images_close(scene.render(kernels), want, decided_by_threshold(scene), max_decided=1.0, max_flips=0)
    found = gradients(scene, kernels, ones(want))
    assert_gradients_close(found, gradients(scene, "reference", ones(want)))


@pytest.mark.parametrize("tau", [1e4, 1e6])
def test_log_sum_exp_at_large_arguments(backend: str, tau: float) -> None:
    """tau H of 1e4 and more, on both sides of the edges: S becomes the maximum, alpha a step of width 1 / kappa."""
    scene = prepared(one_convex(prism([[-0.5, -0.4], [0.5, -0.4], [0.5, 0.4], [-0.5, 0.4]]), tau=tau, kappa=1e4, opacity=0.8), backend)
    frame, _ = assert_finite(scene, backend)
    u, v = (int(x) for x in scene.camera.K[:2, 2])
    assert math.isclose(float(frame.alpha[v, u]), 0.8, rel_tol=1e-6)
    assert float(frame.alpha[0, 0]) == 0


def moved(scene: Scene, by: float) -> Scene:
    """Scene and camera shifted together."""
    shift = torch.tensor([by, -0.5 * by, 0.25 * by], dtype=F64)
    pose = scene.camera.cam_from_world.clone()
    pose[:3, 3] -= pose[:3, :3] @ shift
    changed = {"cam_from_world": pose}
    for name in ("gaussians.means", "convexes.points"):
        changed[name] = scene.tensors()[name] + shift
    return scene.having(changed)


@pytest.mark.parametrize("by", [1.0, 1e3, 1e6])
def test_scene_and_camera_moved_together_look_the_same(backend: str, by: float) -> None:
    """float64 inputs; the kernels' float32 must not see the offset."""
    scene = random_scene(4, gaussians=20, convexes=10, degree=1)
    there = moved(scene, by)
    tolerance = 1e-7 if backend == "reference" else 2e-5
    assert_images_close(there.render(backend), scene.render("reference"), decided_by_threshold(scene, 1e-4), tolerance=tolerance)
    if backend != "reference":
        frame = scene.render("reference")
        weights = {"color": torch.ones_like(frame.color)}
        got, want = gradients(there, backend, weights), gradients(there, "reference", weights)
        for name in ("gaussians.means", "convexes.points", "gaussians.opacities"):
            assert float((got[name] - want[name]).norm()) <= 2e-2 * float(want[name].norm()), name


@pytest.mark.parametrize("width,height", [(1, 1), (17, 33), (33, 17), (16, 16), (2, 50)])
def test_any_size_with_nothing_something_and_everything_culled(backend: str, width: int, height: int) -> None:
    scenes: list[Callable[[], Scene]] = [
        lambda: random_scene(0, width=width, height=height),
        lambda: random_scene(0, gaussians=3, convexes=2, degree=0, width=width, height=height),
        lambda: random_scene(0, gaussians=3, convexes=2, degree=0, extras=1, width=width, height=height),
    ]
    for make in scenes:
        frame, _ = assert_finite(prepared(make(), backend), backend)
        assert frame.color.shape == (height, width, 3)
    behind = scenes[2]()
    behind.camera.cam_from_world[2, 3] = -50.0
    frame, found = assert_finite(prepared(behind, backend), backend)
    assert not frame.visible_gaussians.any() and not frame.visible_convexes.any()
    assert torch.equal(frame.color, behind.background.to(frame.color.dtype).expand(height, width, 3))
    assert not any(gradient.any() for name, gradient in found.items() if name != "background")
