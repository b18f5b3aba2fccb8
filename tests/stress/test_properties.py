"""Hypothesis over shapes, sizes and values: the kernels against the float64 references, in every combination of options."""

from collections.abc import Callable

import torch
from e4dgs.scene.losses.photometric import photometric_loss, ssim_reference
from e4dgs.scene.motion.planes.hexplane import HexPlanes, lookup_reference
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from rasterizer.compare import (
    OUTPUTS,
    assert_gradients_close,
    assert_images_close,
    cotangents,
    decided_by_threshold,
    gradients,
)
from rasterizer.kernels import needs_cpu
from rasterizer.scenes import Scene, generator, looks, make_camera, random_convexes, random_gaussians, uniform

from .against_reference import GRADIENT, IMAGE


def few(examples: int) -> Callable:  # type: ignore[type-arg]
    """The same examples every time, and no clock."""
    return settings(max_examples=examples, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))


OPACITIES = st.sampled_from([0.0, 1.0, 1 / 255, 0.99, 0.004, 0.3, 0.9])
POISON = st.sampled_from([float("nan"), float("inf"), float("-inf"), -1.0])


@st.composite
def scenes(draw: st.DrawFn) -> tuple[Scene, dict[str, list[int]]]:
    """A float32 scene, and by kind the rows that hold a value which culls them."""
    seed = draw(st.integers(0, 10_000))
    n, m, k = draw(st.integers(0, 25)), draw(st.integers(0, 12)), draw(st.integers(3, 8))
    degree, extras = draw(st.sampled_from([None, 0, 1, 2, 3])), draw(st.one_of(st.none(), st.integers(0, 4)))
    camera = make_camera(draw(st.integers(1, 70)), draw(st.integers(1, 70)), seed)
    g = generator(seed)
    gaussians = random_gaussians(seed, n, degree, extras) if n else None
    convexes = random_convexes(seed, m, k, draw(st.sampled_from([None, 0, 3])), extras) if m else None
    if gaussians is not None and draw(st.booleans()):
        # Colours where the other kind has SH, no extras where it has some.
        found = looks(g, n, None, None)
        gaussians.sh, gaussians.colors, gaussians.extras = None, found["colors"], None
    bad: dict[str, list[int]] = {"gaussians": [], "convexes": []}
    for kind, owner, count in (("gaussians", gaussians, n), ("convexes", convexes, m)):
        if owner is None:
            continue
        for row in draw(st.lists(st.integers(0, count - 1), max_size=3)):
            owner.opacities[row] = draw(OPACITIES)
        if draw(st.booleans()):
            row = draw(st.integers(0, count - 1))
            name = draw(st.sampled_from(["scales", "opacities"] if kind == "gaussians" else ["tau", "kappa", "opacities"]))
            getattr(owner, name)[row] = draw(POISON)
            bad[kind].append(row)
    camera.near = draw(st.sampled_from([0.01, 3.0]))  # in front of the scene, or in the middle of it
    scene = Scene(camera, gaussians, convexes, uniform(g, 0, 1, 3), draw(st.booleans()))
    return scene.to(torch.float32), bad


def nudge(scene: Scene) -> Scene:
    """The same with every float32 moved by up to two places in its last digit, towards zero."""
    g = generator(3)
    return scene.having(
        {name: value * (1 - 2**-22 * torch.rand(value.shape, generator=g).to(value.dtype)) for name, value in scene.tensors().items()}
    )


@needs_cpu
@few(60)
@given(scenes())
def test_rasterize_is_finite_in_range_and_like_the_reference(case: tuple[Scene, dict[str, list[int]]]) -> None:
    scene, bad = case
    got, want = scene.render("cpu"), scene.render("reference")
    assert all(bool(torch.isfinite(getattr(got, name)).all()) for name in OUTPUTS)
    assert float(got.alpha.min()) >= 0 and float(got.alpha.max()) <= 1 and float(got.depth.min()) >= 0
    healthy = scene
    for kind, rows in bad.items():
        for row in rows:  # for the comparison of thresholds, which has no mind for bad values
            name = f"{kind}.opacities"
            faint = healthy.tensors()[name].clone()
            faint[row] = 0.0
            healthy = healthy.having({name: faint})
            for other, value in healthy.tensors().items():
                if other.startswith(kind) and other != name:
                    clean = value.clone()
                    clean[row] = (
                        clean[row].nan_to_num(0.5, 0.5, 0.5).abs() if other.split(".")[1] in ("scales", "tau", "kappa") else clean[row]
                    )
                    healthy = healthy.having({other: clean})
    decided = decided_by_threshold(healthy)
    # A small image may be all thresholds; then flips are few all the same, but where an opacity is drawn at the cut itself.
    at_cut = any(bool(((value - 1 / 255).abs() < 1e-8).any()) for name, value in scene.tensors().items() if name.endswith("opacities"))
    flips = 1.0 if at_cut else max(0.01, 1.5 / decided.numel())
    assert_images_close(got, want, decided, tolerance=IMAGE, max_decided=1.0, max_flips=flips)
    weights = cotangents(want, ignore=decided)
    found, exact = gradients(scene, "cpu", weights), gradients(scene, "reference", weights)
    # What few pixels add up to may all but cancel, and then rounding of the inputs and of what each pixel gives, by itself, moves it: by as
    # much more it may be off.
    g = generator(4)
    rounded = {name: w * (1 + 2**-19 * (torch.rand(w.shape, generator=g).double() - 0.5)) for name, w in weights.items()}
    nudged = gradients(nudge(scene), "reference", rounded)
    for name, gradient in exact.items():
        error = (found[name].double() - gradient.double()).norm()
        room = (nudged[name].double() - gradient.double()).norm()
        if 80 * float(room) <= GRADIENT * float(gradient.norm()):  # nothing cancels: no room, and direction and bias count as well
            assert_gradients_close({name: found[name]}, {name: gradient}, relative=GRADIENT, cosine=1e-6)
        assert float(error) <= GRADIENT * float(gradient.norm()) + 8 * float(room) + 1e-12, name
    for kind, rows in bad.items():
        seen = getattr(got, f"visible_{kind}")
        for row in rows:
            assert not bool(seen[row])
            assert all(not bool(g[row].any()) for name, g in found.items() if name.startswith(kind))
    # Culled rows touch nobody: without them the picture is the same to the last bit.
    alone = healthy.render("cpu")
    assert all(torch.equal(getattr(alone, name), getattr(got, name)) for name in OUTPUTS)


@few(40)
@given(
    st.integers(1, 45), st.integers(1, 45), st.sampled_from([(1.0, 0.0), (0.0, 1.0), (0.8, 0.2), (0.0, 0.0)]), st.integers(0, 100),
    st.sampled_from([0.0, 0.01, 0.3, 2.0]),
)  # fmt: skip
def test_photometric_is_like_the_reference_at_any_size(
    height: int, width: int, weights: tuple[float, float], seed: int, noise: float
) -> None:
    """Odd, even, smaller than the window, equal images, and values outside [0, 1]."""
    g = generator(seed)
    y = torch.rand(height, width, 3, generator=g)
    x = (y + noise * torch.randn(y.shape, generator=g)).requires_grad_()
    l1, ssim = weights
    loss = photometric_loss(x, y, l1, ssim)
    (ours,) = torch.autograd.grad(loss, x)
    exact = x.detach().double().requires_grad_()
    expected = l1 * (exact - y).abs().mean() + ssim * (1 - ssim_reference(exact, y.double()))
    (theirs,) = torch.autograd.grad(expected, exact)
    assert abs(float(loss.detach()) - float(expected.detach())) < 2e-6 * max(1.0, float(expected.detach()))
    assert float((ours - theirs).norm()) <= 2e-5 * float(theirs.norm()) + 1e-7


@few(40)
@given(
    st.integers(0, 700), st.lists(st.integers(1, 20), min_size=1, max_size=3), st.integers(1, 9), st.integers(1, 64),
    st.floats(-0.5, 1.5, width=32), st.integers(0, 100),
)  # fmt: skip
def test_hexplane_is_like_the_reference_at_any_size(
    count: int, resolutions: list[int], times: int, channels: int, t: float, seed: int
) -> None:
    g = generator(seed)
    planes = HexPlanes(tuple(resolutions), times, channels)
    with torch.no_grad():
        for p in planes.parameters():
            p.copy_(torch.rand(p.shape, generator=g) + 0.5)
    u = torch.rand(count, 3, generator=g) * 1.4 - 0.2
    u[torch.rand(count, 3, generator=g) < 0.1] = 1.0
    out = planes(u, t)
    weights = torch.randn(out.shape, generator=g)
    ours = torch.autograd.grad(out, [p for pair in zip(planes.space, planes.time) for p in pair], weights)
    exact = [p.detach().double().requires_grad_() for pair in zip(planes.space, planes.time) for p in pair]
    expected = lookup_reference(u.double(), t, *exact)
    theirs = torch.autograd.grad(expected, exact, weights.double())
    assert torch.allclose(out.double(), expected, rtol=1e-4, atol=1e-5)
    for a, b in zip(ours, theirs):
        assert float((a - b).norm()) <= 1e-4 * float(b.norm()) + 1e-9
