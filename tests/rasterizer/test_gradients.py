"""Every gradient of the reference against central differences, on scenes that no threshold is near."""

from functools import cache

import pytest
import torch

from .compare import OUTPUTS, decided_by_threshold, gradients, weigh
from .scenes import F64, Scene, random_scene

STEP = 1e-6
CALM = 2e-4  # distance of every alpha from its thresholds, hundreds of times what a step can change


def scene_by_seed(seed: int, kind: str, degree: int | None) -> Scene:
    counts = {"gaussians": (4, 0), "convexes": (0, 4), "both": (3, 3)}[kind.removesuffix(", antialiased")]
    options = {"points": 5, "degree": degree, "extras": 2, "width": 13, "height": 9, "antialiased": kind.endswith(", antialiased")}
    return random_scene(seed, *counts, spread=0.6, size=0.5, **options)


@cache
def calm_scene(kind: str, degree: int | None) -> Scene:
    """The first of a row of random scenes (W != H, extras) in which no pixel is near a threshold. Searched when a test asks for it, as
    every process of the tests imports this file, and one runs it."""
    for seed in range(200):
        scene = scene_by_seed(seed, kind, degree)
        frame = scene.render()
        drawn = bool(frame.visible_gaussians.all()) and bool(frame.visible_convexes.all())
        if drawn and not bool(decided_by_threshold(scene, CALM, 1e-2, 1e-3).any()):
            return scene
    raise AssertionError("no calm scene found")


SCENES = [(kind, degree) for kind in ("gaussians", "convexes", "both") for degree in (None, 1)]
SCENES += [("both", 3), ("both, antialiased", None)]
CASES = [(kind, degree, name) for kind, degree in SCENES for name in scene_by_seed(0, kind, degree).tensors()]


def free_entries(name: str, value: torch.Tensor) -> list[int]:
    """Flat indices of what the renderer reads: fx, fy, cx, cy of K, the first three rows of cam_from_world, all of the rest."""
    if name == "K":
        return [0, 2, 4, 5]
    return list(range(12 if name == "cam_from_world" else value.numel()))


@pytest.mark.parametrize(("kind", "degree", "name"), CASES)
def test_central_differences(kind: str, degree: int | None, name: str) -> None:
    scene = calm_scene(kind, degree)
    value = scene.tensors()[name].to(F64)
    frame = scene.render()
    weights = {
        output: torch.randn(getattr(frame, output).shape, generator=torch.Generator().manual_seed(7), dtype=F64) for output in OUTPUTS
    }
    analytic = {output: gradients(scene, "reference", {output: weights[output]})[name].flatten() for output in OUTPUTS}

    entries = free_entries(name, value)
    if len(entries) > 48:  # SH of degree 3: random directions instead of one entry at a time
        g = torch.Generator().manual_seed(8)
        directions = [torch.randn(value.shape, generator=g, dtype=F64) for _ in range(12)]
    else:
        directions = [torch.eye(value.numel(), dtype=F64)[i].reshape(value.shape) for i in entries]
    step = STEP * max(1.0, float(value.abs().max()))
    for direction in directions:
        with torch.no_grad():
            ahead = scene.having({name: value + step * direction}).render()
            behind = scene.having({name: value - step * direction}).render()
        for output in OUTPUTS:
            weight = {output: weights[output]}
            numeric = float(weigh(ahead, weight) - weigh(behind, weight)) / (2 * step)
            exact = float(analytic[output] @ direction.flatten())
            scale = float(analytic[output].abs().max())
            assert abs(numeric - exact) <= 1e-6 * scale + 1e-7, f"d {output} / d {name}: {exact} by autograd, {numeric} by differences"


def test_every_input_has_some_gradient() -> None:
    scene = calm_scene("both", 1)
    frame = scene.render()
    found = gradients(scene, "reference", {o: torch.ones_like(getattr(frame, o)) for o in ("color", "depth", "extras")})
    for name, gradient in found.items():
        assert float(gradient.abs().max()) > 0, name


def test_what_is_not_read_has_no_gradient() -> None:
    scene = calm_scene("both", 1)
    frame = scene.render()
    found = gradients(scene, "reference", {o: torch.ones_like(getattr(frame, o)) for o in OUTPUTS})
    read = torch.tensor([[True, False, True], [False, True, True], [False, False, False]])
    assert bool((found["K"][~read] == 0).all())
    assert bool((found["cam_from_world"][3] == 0).all())


def test_the_background_reaches_colour_only() -> None:
    scene = calm_scene("both", None)
    leaves = scene.leaves()
    frame = scene.having(leaves).render()
    assert torch.allclose(
        torch.autograd.grad(frame.color.sum(), leaves["background"], retain_graph=True)[0], (1 - frame.alpha).sum().expand(3)
    )
    for output in (frame.alpha, frame.depth, frame.extras):
        assert torch.autograd.grad(output.sum(), leaves["background"], retain_graph=True, allow_unused=True)[0] is None


def test_a_clamped_slope_carries_no_gradient() -> None:
    """A Gaussian far outside the image: moving it sideways moves its centre, not its covariance; J's 1/z factor stays."""
    from e4dgs.rasterizer.reference.gaussians import project_gaussians

    scene = random_scene(0, gaussians=1, degree=None, extras=1)
    scene.camera.cam_from_world = torch.eye(4, dtype=F64)
    means = torch.tensor([[40.0, 0.3, 4.0]], dtype=F64, requires_grad=True)
    K = scene.camera.K.clone().requires_grad_()
    scene = scene.having({"gaussians.means": means, "K": K})
    assert scene.gaussians is not None
    factors = project_gaussians(scene.camera, scene.gaussians).factors
    along_x, along_z = torch.autograd.grad(factors[0, 0].sum(), means, retain_graph=True)[0][0, [0, 2]].tolist()
    assert along_x == 0
    assert along_z != 0
    assert float(torch.autograd.grad(factors[0, 0].sum(), K)[0][0, 2]) == 0  # the bound holds cx, and is a constant


def test_no_gradient_through_cap_cut_or_clamped_sh() -> None:
    from .scenes import stack

    for opacity in (1.0, 0.5 / 255):  # above the cap, below the cut
        scene = stack(2, opacity)
        found = gradients(scene, "reference", {"alpha": torch.ones(1, 1, dtype=F64)})
        assert bool((found["gaussians.opacities"] == 0).all())
    dark = random_scene(3, gaussians=3, degree=0)
    dark = dark.having({"gaussians.sh": torch.full((3, 1, 3), -5.0, dtype=F64)})
    found = gradients(dark, "reference", {"color": torch.ones(23, 37, 3, dtype=F64)})
    assert bool((found["gaussians.sh"] == 0).all())
    assert float(found["gaussians.opacities"].abs().max()) > 0
