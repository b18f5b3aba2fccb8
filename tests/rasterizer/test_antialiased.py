"""The antialiased mode: what it must do for the eye. That all kernels agree with the reference is in the tests of those."""

import math
from dataclasses import replace

import pytest
import torch
from e4dgs.rasterizer import Camera, Convexes, Gaussians
from e4dgs.rasterizer.reference.antialias import clip_points
from torch import Tensor

from .compare import OUTPUTS, cotangents, gradients, raw_alphas
from .kernels import needs_cpu
from .scenes import F64, Scene, generator, one_convex, prism, random_scene, skew, through_the_camera

BLACK = torch.zeros(3, dtype=F64)
FOCAL = 100.0  # px; at depth 4, a pixel is 0.04 units wide
PIXEL = 4 / FOCAL


def facing(width: int = 32, height: int = 24, at: tuple[float, float] = (0.0, 0.0), near: float = 0.01) -> Camera:
    """A camera at z = -4 that looks along z; `at` moves the picture by so many pixels."""
    K = torch.tensor([[FOCAL, 0, width / 2 + at[0]], [0, FOCAL, height / 2 + at[1]], [0, 0, 1]], dtype=F64)
    pose = torch.eye(4, dtype=F64)
    pose[2, 3] = 4.0
    return Camera(K, pose, width, height, near)


def one_gaussian(scales: list[float], z: float = 0.0, opacity: float = 0.9) -> Scene:
    quats = torch.tensor([[1.0, 0.0, 0.0, 0.0]], dtype=F64)
    means, sizes, opacities = (torch.tensor(x, dtype=F64) for x in ([[0.0, 0.0, z]], [scales], [opacity]))
    return Scene(facing(), Gaussians(means, quats, sizes, opacities, colors=torch.ones(1, 3, dtype=F64)), None, BLACK, True)


def bar(width: float, height: float, opacity: float = 0.9) -> Tensor:
    """[1, 4, 3] corners of a rectangle, in pixels at depth 4."""
    return prism([[s * 0.5 * width * PIXEL, t * 0.5 * height * PIXEL] for s, t in ((-1, -1), (1, -1), (1, 1), (-1, 1))])


def hard(points: Tensor, opacity: float = 0.9) -> Scene:
    """A convex whose edges are far sharper than a pixel."""
    return replace(one_convex(points, tau=4000.0, kappa=4000.0, opacity=opacity), camera=facing(), antialiased=True)


def zoomed(camera: Camera, factor: float) -> Camera:
    K = camera.K.clone()
    K[:2] *= factor
    return replace(camera, K=K, width=round(camera.width * factor), height=round(camera.height * factor))


def filtered(image: Tensor, size: int) -> Tensor:
    """Means over boxes of size x size pixels."""
    height, width = image.shape[0] // size, image.shape[1] // size
    return image.detach().double().reshape(height, size, width, size, -1).mean((1, 3))


def truth(scene: Scene, size: int = 8) -> Tensor:
    """What a pixel's box sees of the classic mode."""
    fine = replace(scene, camera=zoomed(scene.camera, size), antialiased=False)
    return filtered(fine.render("cpu").color, size)


def test_without_the_argument_it_is_the_default_mode(backend: str) -> None:
    scene = random_scene(0, gaussians=30, convexes=15, degree=1, extras=2)
    scene = scene if backend == "reference" else scene.to(torch.float32)
    weights = cotangents(scene.render(backend))
    plain, named = scene.render(backend), scene.render(backend, antialiased=False)
    assert all(torch.equal(getattr(plain, output), getattr(named, output)) for output in OUTPUTS)
    assert not torch.equal(plain.color, scene.render(backend, antialiased=True).color)
    first, second = gradients(scene, backend, weights), gradients(replace(scene, antialiased=True), backend, weights)
    assert all(not torch.equal(first[name], second[name]) for name in first)


def test_primitives_much_larger_than_a_pixel_stay_as_they_are() -> None:
    scene = random_scene(1, gaussians=8, convexes=8, degree=0, size=1.0, width=160, height=120)
    assert scene.convexes is not None
    scene.convexes.kappa.clamp_(max=8.0)
    assert float((replace(scene, antialiased=True).render().color - scene.render().color).abs().max()) < 0.01


@pytest.mark.parametrize("size", [(0.3, 0.3), (0.5, 0.25), (0.2, 2.0), (3.0, 3.0)])
def test_the_total_of_a_small_gaussian_is_that_of_its_area(backend: str, size: tuple[float, float]) -> None:
    """The sum over the pixels, averaged over where the centre lies in its pixel, is o 2 pi s1 s2, less the tail below 1/255. From place to
    place it changes by as much as sampling a Gaussian once a pixel must: by a factor of 1 +- 2 exp(-2 pi^2 variance) along each axis. The
    classic mode draws it 0.3 px^2 larger."""
    scene = one_gaussian([size[0] * PIXEL, size[1] * PIXEL, 0.01])
    want = 0.9 * 2 * math.pi * size[0] * size[1]
    peak = 0.9 * math.sqrt(size[0] ** 2 * size[1] ** 2 / ((size[0] ** 2 + 0.1) * (size[1] ** 2 + 0.1)))
    want *= 1 - 1 / 255 / peak  # a Gaussian's integral where it is above a level
    places = [replace(scene, camera=facing(at=(x / 4, y / 4))) for x in range(4) for y in range(4)]
    places = places if backend == "reference" else [place.to(torch.float32) for place in places]
    totals = [float(place.render(backend).alpha.sum()) for place in places]
    ripple = math.prod(1 + 2 * math.exp(-2 * math.pi**2 * (s * s + 0.1)) for s in size) - 1
    assert sum(totals) / 16 == pytest.approx(want, rel=0.005)
    assert totals == pytest.approx([want] * 16, rel=ripple + 0.01)
    if min(size) < 0.5:
        assert float(replace(places[0], antialiased=False).render(backend).alpha.sum()) > 1.8 * want


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_disc_without_an_area_is_culled_with_zero_gradient(backend: str, axis: int) -> None:
    """Seen from its edge, nothing is left of a flat Gaussian; seen from its face, it is drawn."""
    scales = [0.3, 0.3, 0.3]
    scales[axis] = 1e-12
    scene = one_gaussian(scales)
    scene = scene if backend == "reference" else scene.to(torch.float32)
    frame = scene.render(backend)
    assert bool(frame.visible_gaussians[0]) is (axis == 2)
    for name, gradient in gradients(scene, backend, {"alpha": torch.ones(24, 32, dtype=F64)}).items():
        assert bool(torch.isfinite(gradient).all()), name
        assert axis == 2 or not gradient.any(), name


def test_a_gaussian_fades_between_near_and_twice_near(backend: str) -> None:
    for depth, share in ((0.5, 0.0), (0.625, 0.15625), (0.75, 0.5), (0.875, 0.84375), (1.0, 1.0), (3.0, 1.0)):
        scene = one_gaussian([5.0, 5.0, 5.0], z=depth - 4)
        scene.camera.near = 0.5
        scene = scene if backend == "reference" else scene.to(torch.float32)
        assert float(scene.render(backend).alpha[12, 16]) == pytest.approx(0.9 * share, rel=1e-4), depth


@pytest.mark.parametrize("stretch", [1.0, 2.0])
def test_sharpness_and_opacity_of_a_convex_by_hand(stretch: float) -> None:
    """An oblong of 6 x 2 px. A pixel's size is that of the focal length sqrt(fx fy)."""
    kappa, tau = 100.0, 1000.0
    scene = replace(one_convex(bar(6.0, 2.0), tau=tau, kappa=kappa, opacity=0.8), camera=facing(), antialiased=True)
    scene.camera.K[0, 0] *= stretch
    scene.camera.K[1, 1] /= stretch
    limited = 1 / math.sqrt(1 / kappa**2 + (0.8 * PIXEL / (2 * math.log(9))) ** 2)
    radius = 2 * (6 * 2) / 16 * PIXEL

    def grown(sharpness: float) -> float:
        x = sharpness * radius
        return math.sqrt(1 + 2 * math.pi**2 / 3 / x**2 + (math.pi**2 / 6) ** 2 / x**4)

    share = grown(kappa) / grown(limited)
    assert 0.5 < share < 0.97
    alphas = raw_alphas(scene)[0].reshape(24, 32)
    outside = math.log(4 * 6 / 16) / tau  # the weight of a long edge
    for row in (12, 13, 14):
        distance = (row + 0.5 - 12) * 4 / (FOCAL / stretch) - PIXEL  # from the long edge
        tilt = math.hypot(1, PIXEL / 4)  # of the plane through the camera and the edge
        want = 0.8 * share / (1 + math.exp(limited * (distance / tilt + outside)))
        assert float(alphas[row, 16]) == pytest.approx(want, rel=1e-3)


@needs_cpu
@pytest.mark.parametrize("size", [(0.25, 12.0), (0.5, 8.0), (0.7, 0.7), (1.5, 5.0)])
def test_a_sliver_fades_instead_of_blinking(size: tuple[float, float]) -> None:
    """The total stays near that of a pixel's box, and hardly changes with the place of the sliver between the pixels."""
    points = bar(*size) @ torch.linalg.matrix_exp(skew(torch.tensor([0.0, 0.0, 0.05])))
    totals: dict[str, list[float]] = {"default": [], "antialiased": [], "truth": []}
    for k in range(8):
        scene = replace(hard(points, opacity=0.95), camera=facing(at=(k / 8, k / 11)))
        totals["antialiased"].append(float(scene.render("cpu").alpha.sum()))
        totals["default"].append(float(replace(scene, antialiased=False).render("cpu").alpha.sum()))
        totals["truth"].append(float(truth(scene).sum()) / float(one_convex(points).convexes.colors.sum()))  # type: ignore[union-attr]
    ours, theirs, want = (torch.tensor(totals[name]) for name in ("antialiased", "default", "truth"))
    assert float(ours.mean()) == pytest.approx(float(want.mean()), rel=0.33)
    assert float(ours.std()) < 0.25 * float(theirs.std())


@needs_cpu
@pytest.mark.parametrize("points", [bar(14.0, 10.0), bar(0.5, 16.0), bar(0.25, 16.0), prism([[-0.25, -0.2], [0.25, -0.1], [0.05, 0.2]])])
def test_hard_edges_do_not_crawl(points: Tensor) -> None:
    """The camera moves by a tenth of a pixel a frame: deviation between frames, beyond that of the truth, is halved at least."""
    scene = hard(points @ torch.linalg.matrix_exp(skew(torch.tensor([0.0, 0.0, 0.13]))), opacity=1.0)
    films: dict[str, list[Tensor]] = {"default": [], "antialiased": [], "truth": []}
    for k in range(11):
        frame = replace(scene, camera=facing(at=(0.1 * k, 0.03 * k)))
        films["antialiased"].append(frame.render("cpu").color)
        films["default"].append(replace(frame, antialiased=False).render("cpu").color)
        films["truth"].append(truth(frame))
    moved = {name: torch.stack(film).double().diff(dim=0) for name, film in films.items()}

    def excess(name: str) -> float:
        return float((moved[name].abs() - moved["truth"].abs()).clamp(min=0).mean())

    def deviation(name: str) -> float:
        return float((moved[name] - moved["truth"]).abs().mean())

    assert excess("antialiased") < 0.5 * excess("default")
    assert deviation("antialiased") < 0.5 * deviation("default")


@needs_cpu
@pytest.mark.parametrize("factor", [2, 4])
@pytest.mark.parametrize("kind", [{"gaussians": 150}, {"convexes": 80}, {"gaussians": 100, "convexes": 50}])
def test_a_smaller_picture_is_the_filtered_large_one(kind: dict[str, int], factor: int) -> None:
    """Rendered at 1/2 and 1/4 of the size, against means over the pixels of the full size."""
    better = []
    for seed in range(3):
        scene = random_scene(seed, degree=None, width=96, height=72, size=0.1, **kind)
        if scene.convexes is not None:
            scene.convexes.kappa.mul_(10), scene.convexes.tau.mul_(4)
        want = filtered(scene.render("cpu").color, factor)
        small = replace(scene, camera=zoomed(scene.camera, 1 / factor))
        plain, ours = (float((small.render("cpu", antialiased=mode).color.double() - want).square().mean()) for mode in (False, True))
        better.append(10 * math.log10(plain / ours))
    assert min(better) > (4.0 if factor == 2 else 5.5), better  # dB


@needs_cpu
@pytest.mark.parametrize(("kind", "least"), [({"gaussians": 150}, 55.0), ({"convexes": 80}, 42.0)])
def test_a_pixel_is_the_mean_over_its_box(kind: dict[str, int], least: float) -> None:
    """Against the same scene at eight times the size, averaged: 20 dB closer than the classic mode for Gaussians, 5 for convexes."""
    for seed in range(3):
        scene = random_scene(seed, degree=None, width=96, height=72, size=0.1, **kind)
        if scene.convexes is not None:
            scene.convexes.kappa.mul_(10), scene.convexes.tau.mul_(4)
        want = truth(scene)
        plain, ours = (-10 * math.log10((scene.render("cpu", antialiased=m).color.double() - want).square().mean()) for m in (False, True))
        assert ours > least and plain < 40.0, (plain, ours)


PASSED = {
    "a floor": torch.tensor([[[-0.5, 0.3, -1], [0.5, 0.3, -1], [0.5, 0.3, 1], [-0.5, 0.3, 1]]], dtype=F64),
    "beside the camera": torch.tensor([[[0.3, 0.1, -1], [0.6, 0.2, 0.5], [0.3, -0.3, 1], [0.9, 0.5, 1], [0.2, 0, 0]]], dtype=F64),
    "through the camera": 0.4 * torch.randn(1, 6, 3, generator=generator(5), dtype=F64),
}


@needs_cpu
@pytest.mark.parametrize("points", PASSED.values(), ids=PASSED.keys())
def test_a_camera_that_passes_a_convex_sees_no_jump(points: Tensor) -> None:
    """With a quarter of the step, the largest change between two frames is a quarter. By default, the convex vanishes at once."""
    scene = one_convex(points, tau=40.0, kappa=40.0)

    def largest_change(steps: int, antialiased: bool) -> float:
        film = []
        for k in range(steps + 1):
            camera = facing(near=0.2)
            camera.cam_from_world[2, 3] = 1.6 - 3.2 * k / steps
            film.append(replace(scene, camera=camera).render("cpu", antialiased=antialiased).alpha)
        assert float(film[0].max()) > 0.5 and not film[-1].any()
        return float(torch.stack(film).diff(dim=0).abs().max())

    coarse, fine = largest_change(300, True), largest_change(1200, True)
    assert fine < 0.06 and fine < max(0.4 * coarse, 1.1 / 255)  # at an alpha of 1/255 there always is a step
    assert largest_change(300, False) > 0.5


def test_clipped_points_lie_in_the_plane_and_inside_the_hull() -> None:
    g = generator(7)
    points = torch.randn(200, 6, 3, generator=g, dtype=F64)
    points = points[(points[..., 2] > 0.1).any(1)]
    clipped = clip_points(points, 0.1)
    front = points[..., 2] >= 0.1
    assert torch.equal(clipped[front], points[front])
    assert torch.equal(clipped[~front][:, 2], torch.full((int((~front).sum()),), 0.1, dtype=F64))
    directions = torch.randn(50, 3, generator=g, dtype=F64)  # inside: no direction in which a point lies further out than all of the hull
    assert bool(((clipped @ directions.T).amax(1) <= (points @ directions.T).amax(1) + 1e-12).all())


def test_a_convex_around_the_camera_has_a_colour(backend: str) -> None:
    """Its centroid is the camera's centre, from which there is no view direction."""
    box = torch.tensor([[[x, y, z] for x in (-1.0, 1) for y in (-1.0, 1) for z in (-1.0, 1)]], dtype=F64)
    sh = torch.randn(1, 4, 3, generator=generator(8), dtype=F64)
    number = torch.ones(1, dtype=F64)
    camera = replace(facing(), cam_from_world=torch.eye(4, dtype=F64))
    scene = Scene(camera, None, Convexes(box, 20 * number, 20 * number, 0.9 * number, sh=sh), BLACK, True)
    scene = scene if backend == "reference" else scene.to(torch.float32)
    frame = scene.render(backend)
    assert float(frame.alpha.min()) > 0.8
    assert bool(torch.isfinite(frame.color).all())
    assert all(bool(torch.isfinite(gradient).all()) for gradient in gradients(scene, backend, cotangents(frame)).values())


def test_what_crosses_the_near_plane_has_finite_gradients(backend: str) -> None:
    scene = through_the_camera(6, gaussians=40, convexes=30, degree=0, size=0.5)
    scene = scene if backend == "reference" else scene.to(torch.float32)
    frame = scene.render(backend)
    found = gradients(scene, backend, cotangents(frame))
    assert all(bool(torch.isfinite(gradient).all()) for gradient in found.values())
    assert bool(found["convexes.points"][frame.visible_convexes].flatten(1).any(1).all())
