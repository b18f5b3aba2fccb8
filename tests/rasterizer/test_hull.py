"""Hulls: what counts as a corner, and what a render may and may not notice of the points that make it."""

import math

import pytest
import torch
from e4dgs.rasterizer.reference.convexes import is_degenerate
from e4dgs.rasterizer.reference.hull import hull_area, hull_corners, turn
from hypothesis import given, settings
from hypothesis import strategies as st

from .compare import gradients, raw_alphas
from .kernels import needs_cpu
from .scenes import F64, Scene, generator, one_convex, prism, random_scene
from .test_cpu_kernels import check

# Small integers, so that collinear and coincident points are common and every cross product is exact.
whole = st.integers(-3, 3).map(float)
point = st.tuples(whole, whole)
some_points = st.lists(point, min_size=3, max_size=8)


def is_corner(points: list[tuple[float, float]], p: tuple[float, float]) -> bool:
    """Extreme: no closed triangle or segment of other points holds p (by definition, in O(n^3))."""
    others = sorted({q for q in points if q != p})
    for n, a in enumerate(others):
        for b in others[n + 1 :]:
            between = turn(a, b, p) == 0 and min(a, b) <= p <= max(a, b)
            if between:
                return False
            for c in others:
                signs = [turn(a, b, p), turn(b, c, p), turn(c, a, p)]
                if turn(a, b, c) != 0 and (min(signs) >= 0 or max(signs) <= 0):
                    return False
    return True


@given(some_points)
@settings(max_examples=150, deadline=None)
def test_corners_are_the_extreme_points_each_once(points: list[tuple[float, float]]) -> None:
    corners = [points[i] for i in hull_corners(points)]
    assert len(corners) == len(set(corners))
    assert set(corners) == {p for p in points if is_corner(points, p)}


@given(some_points)
@settings(max_examples=100, deadline=None)
def test_corners_turn_one_way_and_enclose_all(points: list[tuple[float, float]]) -> None:
    corners = [points[i] for i in hull_corners(points)]
    if len(corners) < 3:
        assert is_degenerate(points, hull_corners(points))
        return
    assert hull_area(points, hull_corners(points)) > 0
    for a, b in zip(corners, corners[1:] + corners[:1]):
        assert all(turn(a, b, p) >= 0 for p in points)


@pytest.mark.parametrize(
    ("points", "corners"),
    [
        ([(0, 0), (1, 0), (1, 1), (0, 1)], {0, 1, 2, 3}),
        ([(0, 0), (1, 0), (2, 0), (2, 2), (1, 1)], {0, 2, 3}),  # one on an edge, one on the diagonal edge
        ([(0, 0), (4, 0), (0, 4), (1, 1), (4, 0)], None),  # an inner point and a duplicate
        ([(0, 0), (1, 1), (2, 2)], {0, 2}),
        ([(1, 1), (1, 1), (1, 1)], None),
    ],
)
def test_known_hulls(points: list[tuple[float, float]], corners: set[int] | None) -> None:
    found = hull_corners([(float(x), float(y)) for x, y in points])
    if corners is not None:
        assert set(found) == corners
    assert len({points[i] for i in found}) == len(found)


@given(some_points, st.randoms(use_true_random=False))
@settings(max_examples=40, deadline=None)
def test_any_order_of_the_points_gives_the_same_render(points: list[tuple[float, float]], random: object) -> None:
    order = list(range(len(points)))
    random.shuffle(order)  # type: ignore[attr-defined]
    one, other = (one_convex(prism([[x / 3, y / 3] for x, y in ps])).render() for ps in (points, [points[i] for i in order]))
    assert torch.allclose(one.color, other.color, atol=1e-12)
    assert torch.equal(one.visible_convexes, other.visible_convexes)


DEGENERATE = {
    "collinear": [[0, 0], [0.2, 0.2], [0.4, 0.4], [-0.3, -0.3]],
    "collinear, none of the coordinates exact": [[0.1 * i, 0.07 * i + 0.013] for i in range(6)],
    "coincident": [[0.3, 0.1]] * 6,
    "two distinct points": [[0.3, 0.1], [-0.2, 0.4]] * 3,
    "a sliver": [[-0.5, 0], [0.5, 0], [0, 1e-6]],
}


@pytest.mark.parametrize("corners", DEGENERATE.values(), ids=DEGENERATE.keys())
def test_degenerate_hulls_are_culled_with_zero_gradient(corners: list[list[float]]) -> None:
    scene = one_convex(prism(corners))
    frame = scene.render()
    assert not bool(frame.visible_convexes.any())
    assert float(frame.alpha.abs().max()) == 0
    found = gradients(scene, "reference", {"color": torch.ones_like(frame.color), "depth": torch.ones_like(frame.depth)})
    for name in ("convexes.points", "convexes.tau", "K", "cam_from_world"):
        assert bool((found[name] == 0).all()), name


def test_the_degenerate_rule_has_its_threshold_at_area_1e_5_of_the_squared_extent() -> None:
    def thin(height: float) -> list[tuple[float, float]]:
        return [(0.0, 0.0), (2.0, 0.0), (1.0, height)]  # area = height, squared extent = 4

    assert is_degenerate(thin(3.9e-5), [0, 1, 2])
    assert not is_degenerate(thin(4.1e-5), [0, 1, 2])


PENTAGON = [[0.6 * math.cos(t), 0.5 * math.sin(t)] for t in (0.1, 1.2, 2.6, 3.7, 5.1)]


def test_an_inner_point_matters_through_the_centroid_only() -> None:
    """Moved about at its depth it changes nothing; moved in depth it moves the centroid's z, hence H and the order."""
    renders = [one_convex(prism([*PENTAGON, inner])).render() for inner in ([0.0, 0.0], [0.2, -0.1], [-0.1, 0.25])]
    for other in renders[1:]:
        assert torch.allclose(renders[0].color, other.color, atol=1e-12)
    nearer = prism([*PENTAGON, [0.0, 0.0]])
    nearer[0, 5, 2] = -0.6  # z 3.4 instead of 4, so the centroid's is 3.9
    moved = one_convex(nearer).render()
    at = moved.alpha > 0
    assert torch.allclose(moved.depth[at], torch.tensor(3.9, dtype=F64))
    assert float((moved.alpha - renders[0].alpha).abs().max()) > 1e-3


def test_adding_an_inner_point_at_the_centroid_shifts_s_by_a_constant() -> None:
    """w_i = K l_i / sum(l): one more point and the same hull and centroid add ln((K + 1) / K) / tau to S, the same at every pixel."""
    centroid = [sum(p[axis] for p in PENTAGON) / 5 for axis in (0, 1)]
    tau, kappa, opacity = 12.0, 15.0, 0.9

    def level(points: list[list[float]]) -> torch.Tensor:
        raw, _ = raw_alphas(one_convex(prism(points), tau, kappa, opacity))
        return torch.log(opacity / raw - 1) / kappa  # S, from alpha = o / (1 + exp(kappa S))

    shift = level([*PENTAGON, centroid]) - level(PENTAGON)
    assert torch.allclose(shift, torch.tensor(math.log(6 / 5) / tau, dtype=F64), atol=1e-8)


def crossing(offset: float) -> Scene:
    """A square and a fifth point at `offset` outside the middle of one of its edges (inside where negative)."""
    return one_convex(prism([[-0.5, -0.4], [0.5, -0.4], [0.5, 0.4], [-0.5, 0.4], [0.5 + offset, 0.03]]), tau=6.0, kappa=40.0)


def test_alpha_is_continuous_when_a_point_crosses_the_hull() -> None:
    before, at, after = (raw_alphas(crossing(offset))[0] for offset in (-1e-7, 0.0, 1e-7))
    assert float((before - at).abs().max()) < 1e-5
    assert float((after - at).abs().max()) < 1e-5
    assert float(at.max() - at.min()) > 0.5  # the convex is in the picture


def test_alpha_is_continuous_when_a_point_passes_through_a_corner() -> None:
    square = [[-0.5, -0.4], [0.5, -0.4], [0.5, 0.4], [-0.5, 0.4]]
    renders = [raw_alphas(one_convex(prism([*square, [0.5 + x, 0.4 + y]]), tau=6.0, kappa=40.0))[0] for x, y in
               ((0, 0), (1e-7, 1e-7), (-1e-7, 0), (0, 1e-7), (-1e-7, -1e-7), (1e-7, -1e-7))]  # fmt: skip
    for other in renders[1:]:
        assert float((other - renders[0]).abs().max()) < 1e-5


def test_gradients_stay_finite_and_bounded_on_a_vanishing_edge() -> None:
    """The normal's gradient grows like 1/l, its weight shrinks like l: the product stays where it is."""
    sizes = []
    for offset in (1e-3, 1e-6, 1e-9, 1e-12):
        found = gradients(crossing(offset), "reference", {"alpha": torch.ones(15, 21, dtype=F64)})["convexes.points"]
        assert bool(torch.isfinite(found).all())
        square = torch.tensor(
            [[[-0.5, -0.4, 0], [0.5, -0.4, 0], [0.5, 0.4, 0], [-0.5, 0.4, 0], [0.5 + offset, 0.4 + offset, 0]]], dtype=F64
        )
        found = gradients(one_convex(square), "reference", {"alpha": torch.ones(15, 21, dtype=F64)})["convexes.points"]
        assert bool(torch.isfinite(found).all())
        sizes.append(float(found.norm()))
    assert max(sizes) < 2 * min(sizes)


@pytest.mark.parametrize("times", [0.5, 1, 2, 3, 4])
def test_a_convex_looks_the_same_at_any_resolution(times: float) -> None:
    """Pixels that look along the same ray see the same alpha, whatever the size of the image."""
    small, large = (1.0, times) if times >= 1 else (times, 1.0)
    every = round(large / small)
    scene = random_scene(2, convexes=4, points=6, degree=None, width=17, height=11)

    def at(scale: int) -> torch.Tensor:
        # Scaled about the centre of pixel (0, 0), so that pixel (i, j) looks along the ray of pixel (scale i, scale j).
        K = scene.camera.K.clone()
        K[:2, :2] *= scale
        K[:2, 2] = scale * (K[:2, 2] - 0.5) + 0.5
        view = scene.having({"K": K})
        view.camera.width, view.camera.height = 17 * scale, 11 * scale
        return view.render().color

    assert torch.allclose(at(every)[::every, ::every], at(1), atol=1e-12)


def test_sharpness_does_not_depend_on_distance_at_the_same_world_offset() -> None:
    """tau and kappa are in 1 / world unit: twice as far at twice the focal length, alpha is the same picture."""
    near = one_convex(prism(PENTAGON))
    far = one_convex(prism(PENTAGON))
    far.camera.cam_from_world[2, 3] = 8.0
    far.camera.K[:2, :2] *= 2
    # The normals tilt less at twice the distance: the difference is of second order in the slope, here at most 0.15.
    assert float((near.render().alpha - far.render().alpha).abs().max()) < 0.02


@pytest.mark.parametrize(("depth", "is_corner"), [(1.9e-12, False), (2.1e-12, True)])
@pytest.mark.parametrize("backend", ["reference", pytest.param("cpu", marks=needs_cpu)])
def test_a_point_within_rounding_of_an_edge_is_no_corner(depth: float, is_corner: bool, backend: str) -> None:
    """Extent 2, so that the triangle (-1, 0) (0, -depth) (1, 0) has a turn of 2 depth against FLAT 2^2 = 4e-12."""
    corners = [[-1.0, 0.0], [0.0, -depth], [1.0, 0.0], [0.0, 1.0]]
    points = torch.tensor([[*xy, 1.0] for xy in corners], dtype=torch.float32)[None]
    scene = one_convex(points.double()).to(torch.float32)
    scene.camera.cam_from_world = torch.eye(4)
    scene.camera.K = torch.tensor([[8.0, 0, 10.5], [0, 8.0, 7.5], [0, 0, 1]])
    gradient = gradients(scene, backend, {"color": torch.ones_like(scene.render(backend).color)})["convexes.points"][0]
    assert bool(gradient[1, :2].any()) == is_corner
    assert gradient[[0, 2, 3], :2].abs().amin(0).max() > 0


@needs_cpu
@pytest.mark.parametrize("count", range(3, 9))
def test_kernels_take_the_same_corners_for_many_hulls_at_once(instruction_set: str, count: int) -> None:
    """Hulls of all kinds side by side in a vector: points of a coarse grid, so that most have points on edges or upon one another."""
    scene = random_scene(count, convexes=45, points=count, degree=None, width=40, height=30).to(torch.float32)
    grid = torch.randint(-2, 3, (45, count, 3), generator=generator(count)).float()
    centres = scene.convexes.points.mean(1, keepdim=True)
    check(scene.having({"convexes.points": centres + 0.2 * grid * torch.tensor([1.0, 1.0, 0.0])}), max_decided=0.1)
