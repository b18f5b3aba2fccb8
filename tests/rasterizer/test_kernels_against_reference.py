"""All kernels against the float64 oracle: images within 2e-5 outside threshold pixels, every gradient within 1e-3."""

from dataclasses import replace

import pytest
import torch
from e4dgs.rasterizer import TILE

from .compare import assert_gradients_close, assert_images_close, cotangents, decided_by_threshold, gradients
from .kernels import ALL_KERNELS, EMULATED, needs_cpu
from .scenes import F64, Scene, needles, one_convex, prism, random_scene, through_the_camera

SCENES = {
    "gaussians sh0": {"gaussians": 60, "degree": 0},
    "gaussians sh1": {"gaussians": 60, "degree": 1},
    "gaussians sh2": {"gaussians": 60, "degree": 2},
    "gaussians sh3": {"gaussians": 60, "degree": 3},
    "gaussians colors extras": {"gaussians": 60, "degree": None, "extras": 3},
    "many small gaussians": {"gaussians": 250, "degree": 1, "size": 0.08, "width": 50, "height": 36},
    "large gaussians": {"gaussians": 20, "degree": 1, "size": 3.0},
    **{f"convexes K={k}": {"convexes": 25, "points": k, "degree": 1} for k in range(3, 9)},
    "convexes sh3 extras": {"convexes": 25, "degree": 3, "extras": 2},
    "small convexes": {"convexes": 90, "degree": 0, "size": 0.06, "width": 50, "height": 36},
    "both colors": {"gaussians": 40, "convexes": 20, "degree": None},
    "both sh3 extras": {"gaussians": 40, "convexes": 20, "degree": 3, "extras": 5},
    "both, one pixel": {"gaussians": 10, "convexes": 10, "degree": 2, "extras": 1, "width": 1, "height": 1},
    "both 17x33": {"gaussians": 30, "convexes": 20, "degree": 2, "width": 17, "height": 33},
    "both 33x17": {"gaussians": 30, "convexes": 20, "degree": 2, "extras": 1, "width": 33, "height": 17},
    "both, antialiased": {"gaussians": 40, "convexes": 20, "degree": 1, "extras": 2, "antialiased": True},
    "small both, antialiased": {
        "gaussians": 120,
        "convexes": 80,
        "degree": 0,
        "size": 0.04,
        "width": 50,
        "height": 36,
        "antialiased": True,
    },
    "convexes K=8, antialiased": {"convexes": 25, "points": 8, "degree": None, "antialiased": True},
    "both, beside the image": {"gaussians": 60, "convexes": 30, "degree": 1, "spread": 4.0, "width": 45, "height": 20},
}


# What differs between the CUDA kernels' programs; all scenes run on a GPU, and with `--kernels=cuda` emulated.
FEW = ("gaussians colors extras", "convexes K=8", "both sh3 extras", "both 33x17", "both, antialiased", "small both, antialiased")
CASES = [
    pytest.param(kernels.values[0], name, seed, marks=kernels.marks, id=f"{kernels.values[0]}-{name}-{seed}")
    for kernels in ALL_KERNELS
    for name in (FEW if kernels.values[0] == EMULATED else SCENES)
    for seed in ((0,) if kernels.values[0] == EMULATED else (0, 1))
]


def check(scene: Scene, kernels: str, seed: int = 0, **limits: float) -> None:
    """Render the same float32 numbers with both backends; compare images, visibility and all gradients."""
    single = scene.to(torch.float32)
    got, want = single.render(kernels), single.render("reference")
    assert got.color.dtype == torch.float32
    decided = decided_by_threshold(single)
    assert_images_close(got, want, decided, **limits)
    # Who is certainly blended must be visible: judge by the pixels that no threshold decides.
    for kind in ("gaussians", "convexes"):
        seen, blended = getattr(got, f"visible_{kind}"), getattr(want, f"visible_{kind}")
        assert seen.dtype == torch.bool and seen.shape == blended.shape
        assert int((blended & ~seen).sum()) <= int(decided.sum())
    weights = cotangents(want, ignore=decided, seed=seed)
    assert_gradients_close(gradients(single, kernels, weights), gradients(single, "reference", weights))


@pytest.mark.parametrize(("kernels", "name", "seed"), CASES, indirect=["kernels"])
def test_random_scenes(kernels: str, name: str, seed: int) -> None:
    options = SCENES[name]
    max_decided = 1.0 if options.get("width") == 1 else 0.05
    check(random_scene(seed, **options), kernels, seed, max_decided=max_decided)


@pytest.mark.parametrize("output", ["color", "alpha", "depth", "extras"])
def test_each_output_alone_backpropagates(kernels: str, output: str) -> None:
    """A loss on one output only: the backward pass must not need the others' gradients, nor mix them up."""
    scene = random_scene(5, gaussians=30, convexes=15, degree=1, extras=2).to(torch.float32)
    want = scene.render("reference")
    weights = cotangents(want, ignore=decided_by_threshold(scene), outputs=(output,))
    assert_gradients_close(gradients(scene, kernels, weights), gradients(scene, "reference", weights))


def test_opaque_layers_that_stop_pixels(kernels: str) -> None:
    scene = random_scene(6, gaussians=60, convexes=30, degree=1, size=1.2)
    assert scene.gaussians is not None and scene.convexes is not None
    scene.gaussians.opacities[:] = scene.gaussians.opacities**0.05
    scene.convexes.opacities[:] = 1.0
    check(scene, kernels)


@pytest.mark.parametrize("antialiased", [False, True])
def test_needles_and_plates(kernels: str, antialiased: bool) -> None:
    check(replace(needles(), antialiased=antialiased), kernels)


@pytest.mark.parametrize("points", [3, 6])
def test_primitives_that_cross_the_near_plane(kernels: str, points: int) -> None:
    scene = through_the_camera(5, gaussians=60, convexes=40, points=points, degree=1, extras=2, size=0.3)
    visible = scene.render("reference").visible_convexes
    assert int(visible.sum()) > int(replace(scene, antialiased=False).render("reference").visible_convexes.sum())
    check(scene, kernels, max_decided=0.15)


@pytest.mark.parametrize("tau", [1.0, 30.0, 1000.0])
@pytest.mark.parametrize("kappa", [1.0, 30.0, 1000.0])
def test_soft_and_sharp_convexes(kernels: str, tau: float, kappa: float) -> None:
    scene = random_scene(7, convexes=15, degree=0)
    assert scene.convexes is not None
    scene.convexes.tau[:] = tau
    scene.convexes.kappa[:] = kappa
    check(scene, kernels)


def test_convexes_with_inner_and_duplicate_points_and_points_on_edges(kernels: str) -> None:
    square = [[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]]
    for more in ([[0.0, 0.0]], [[0.5, 0.5]], [[0.1, 0.2], [0.1, 0.2]], [[0.3, -0.1], [-0.5, -0.5], [0.0, 0.1]]):
        scene = one_convex(prism(square + more))
        scene.camera.cam_from_world[:3, :3] = torch.linalg.matrix_exp(
            torch.tensor([[0.0, -0.1, 0.2], [0.1, 0, -0.15], [-0.2, 0.15, 0]], dtype=F64)
        )
        check(scene, kernels)


def test_gradients_reach_float64_inputs_in_their_own_precision(kernels: str) -> None:
    scene = random_scene(8, gaussians=20, convexes=10, degree=1, extras=1)
    want = scene.render("reference")
    weights = cotangents(want, ignore=decided_by_threshold(scene))
    got = gradients(scene, kernels, weights)
    assert {g.dtype for g in got.values()} == {F64}
    assert_gradients_close(got, gradients(scene, "reference", weights))


@needs_cpu
def test_auto_is_the_cpu_kernels_for_tensors_on_the_cpu() -> None:
    scene = random_scene(0, gaussians=5).to(torch.float32)
    assert torch.equal(scene.render("auto").color, scene.render("cpu").color)


def some_tiles(scene: Scene, seed: int = 0) -> Scene:
    """The scene, of which only about half of the tiles are drawn."""
    rows, columns = -(-scene.camera.height // TILE), -(-scene.camera.width // TILE)
    return replace(scene, tiles=torch.rand(rows, columns, generator=torch.Generator().manual_seed(seed)) < 0.5)


@pytest.mark.parametrize("antialiased", [False, True])
def test_only_the_tiles_that_are_asked_for(kernels: str, antialiased: bool) -> None:
    options = {"gaussians": 60, "convexes": 30, "degree": 1, "extras": 2, "size": 0.4, "width": 90, "height": 70}
    check(some_tiles(random_scene(7, **options, antialiased=antialiased)), kernels)


def test_tiles_are_the_same_as_without_the_others_and_these_show_the_background(kernels: str) -> None:
    whole = random_scene(8, gaussians=80, convexes=30, degree=0, extras=1, width=90, height=70).to(torch.float32)
    part = some_tiles(whole)
    want, got = whole.render(kernels), part.render(kernels)
    assert part.tiles is not None and 0 < int(part.tiles.sum()) < part.tiles.numel()
    drawn = part.tiles.repeat_interleave(TILE, 0).repeat_interleave(TILE, 1)[:70, :90]
    for name in ("color", "alpha", "depth", "extras"):
        assert torch.equal(getattr(got, name)[drawn], getattr(want, name)[drawn]), name
    assert torch.equal(got.color[~drawn], part.background.expand(int((~drawn).sum()), 3))
    for name in ("alpha", "depth", "extras"):
        assert not getattr(got, name)[~drawn].any(), name
    weights = {name: value * drawn.reshape(70, 90, *[1] * (value.dim() - 2)) for name, value in cotangents(want).items()}
    assert_gradients_close(gradients(part, kernels, weights), gradients(whole, kernels, weights), relative=1e-6)


def test_no_tile_at_all_is_the_background_without_gradient(kernels: str) -> None:
    scene = random_scene(9, gaussians=20, convexes=10, degree=1).to(torch.float32)
    scene = replace(scene, tiles=torch.zeros_like(some_tiles(scene).tiles))
    frame = scene.render(kernels)
    assert not frame.alpha.any() and not frame.visible_gaussians.any() and not frame.visible_convexes.any()
    found = gradients(scene, kernels, cotangents(frame))
    assert all(not value.any() for name, value in found.items() if "." in name)
