"""Hulls that fail to be polygons, and points that come in any order, drawn by the kernels."""

import itertools
import math

import pytest
import torch
from rasterizer.compare import OUTPUTS, gradients
from rasterizer.kernels import needs_cpu
from rasterizer.scenes import F64, Scene, one_convex, prism, random_scene

from .against_reference import GRADIENT, check

pytestmark = needs_cpu

FLAT = {
    "collinear": [[0, 0], [0.2, 0.2], [0.4, 0.4], [-0.3, -0.3]],
    "collinear along x": [[-0.4, 0.1], [0.0, 0.1], [0.3, 0.1], [0.4, 0.1]],
    "collinear, none of the coordinates exact": [[0.1 * i - 0.3, 0.07 * i + 0.013] for i in range(6)],
    "coincident": [[0.3, 0.1]] * 6,
    "two distinct points": [[0.3, 0.1], [-0.2, 0.4]] * 3,
    "a sliver": [[-0.5, 0], [0.5, 0], [0, 1e-6]],
}


@pytest.mark.parametrize("corners", FLAT.values(), ids=FLAT.keys())
def test_flat_hulls_are_culled_alone_with_zero_gradient(corners: list[list[float]]) -> None:
    """Beside healthy convexes, whose picture and gradients stay as they are to the last bit."""
    crowd = random_scene(31, convexes=6, points=len(corners), degree=None, spread=0.5).to(torch.float32)
    flat = one_convex(prism(corners)).tensors()["convexes.points"].float()[0]
    assert crowd.convexes is not None
    faint, poisoned = crowd.convexes.opacities.clone(), crowd.convexes.points.clone()
    faint[2], poisoned[2] = 0.0, flat
    without, scene = crowd.having({"convexes.opacities": faint}), crowd.having({"convexes.points": poisoned})
    want, got = without.render("cpu"), scene.render("cpu")
    assert not bool(got.visible_convexes[2]) and bool(got.visible_convexes.any())
    weights = {name: torch.ones_like(getattr(want, name)) for name in OUTPUTS}
    for name in OUTPUTS:
        assert torch.equal(getattr(got, name), getattr(want, name)), name
    theirs = gradients(without, "cpu", weights)
    for name, gradient in gradients(scene, "cpu", weights).items():
        if name.startswith("convexes."):
            assert not gradient[2].any(), name
            gradient[2] = theirs[name][2]
        assert torch.equal(gradient, theirs[name]), name


def rays(*polar: tuple[float, float]) -> list[list[float]]:
    return [[-0.4 + r * math.cos(a), -0.3 + r * math.sin(a)] for r, a in polar]


EQUAL_ANGLES = {
    # Seen from the first point, which Graham's scan sorts about, several points lie on one ray.
    "two on a ray": rays((0, 0), (0.4, 0.2), (0.8, 0.2), (0.7, 1.2)),
    "two on every ray": rays((0, 0), (0.4, 0.1), (0.9, 0.1), (0.3, 0.7), (0.6, 0.7), (0.2, 1.3), (0.7, 1.3)),
    "on the first and the last ray": rays((0, 0), (0.3, 0.0), (0.9, 0.0), (0.3, math.pi / 2), (0.7, math.pi / 2), (0.4, 0.8)),
    "a grid": [[x, y] for x in (-0.4, 0.0, 0.4) for y in (-0.3, 0.3)] + [[0.0, 0.0]],
    "on the edges of a square": [[-0.4, -0.4], [0.4, -0.4], [0.4, 0.4], [-0.4, 0.4], [0, -0.4], [0.4, 0], [0, 0.4], [-0.4, 0]],
    "every corner twice": [[-0.4, -0.3], [0.5, -0.4], [0.4, 0.4], [-0.3, 0.3]] * 2,
}


@pytest.mark.parametrize("corners", EQUAL_ANGLES.values(), ids=EQUAL_ANGLES.keys())
def test_points_at_equal_angles(corners: list[list[float]]) -> None:
    check(several(corners))


def several(corners: list[list[float]], width: int = 33, height: int = 21) -> Scene:
    """Six of this convex side by side, one behind the other: single gradients may be sums that all but cancel, those of six do not."""
    scene = one_convex(prism(corners), width=width, height=height)
    shift = torch.tensor([[0.3 * (i % 3 - 1), 0.2 * (i % 2), 0.25 * i] for i in range(6)], dtype=F64)
    one = scene.tensors()
    many = {name: one[name].repeat(6, *[1] * (one[name].dim() - 1)) for name in one if name.startswith("convexes.")}
    many["convexes.points"] = many["convexes.points"] + shift[:, None]
    many["convexes.opacities"] = torch.linspace(0.3, 0.8, 6, dtype=F64)
    many["convexes.colors"] = many["convexes.colors"] * torch.linspace(0.2, 1.2, 6, dtype=F64)[:, None]
    return scene.having(many)


def turned(scene: Scene) -> Scene:
    scene.camera.cam_from_world[:3, :3] = torch.linalg.matrix_exp(
        torch.tensor([[0.0, -0.1, 0.2], [0.1, 0, -0.15], [-0.2, 0.15, 0]], dtype=F64)
    )
    return scene


@pytest.mark.parametrize("corners", EQUAL_ANGLES.values(), ids=EQUAL_ANGLES.keys())
def test_points_at_equal_angles_seen_from_aside(corners: list[list[float]]) -> None:
    """Rounding then decides what is a corner: whoever decides how, the picture is the same."""
    single = turned(several(corners))
    check(single, max_decided=0.1)


def test_a_hull_of_a_few_float32_steps() -> None:
    """Points that are coincident but for the last bits still span a polygon: it is drawn as the reference draws it."""
    step = 2.0**-24
    scene = several([[0.3, 0.1], [0.3 + 3 * step, 0.1], [0.3 + 2 * step, 0.1 + 4 * step], [0.3 - step, 0.1 + 2 * step]])
    check(scene, outputs=("color",))


@pytest.mark.parametrize("inner", [None, [0.05, 0.02]])
def test_any_permutation_of_the_points(inner: list[float] | None) -> None:
    """All 120 orders of five points, a hull of five corners or of four with a point inside: one picture, and gradients that follow."""
    corners = [[-0.5, -0.4], [0.5, -0.45], [0.6, 0.2], [0.1, 0.5], inner or [-0.55, 0.3]]
    points = prism(corners).float()
    points[0, :, 2] = torch.tensor([0.0, 0.3, -0.2, 0.1, 0.2])
    scene = one_convex(points.double()).to(torch.float32)
    want = scene.render("cpu")
    weights = {"color": torch.ones_like(want.color), "depth": torch.ones_like(want.depth)}
    theirs = gradients(scene, "cpu", weights)["convexes.points"][0]
    for order in itertools.permutations(range(5)):
        other = scene.having({"convexes.points": points[:, list(order)]})
        assert float((other.render("cpu").color - want.color).abs().max()) < 1e-6, order
        ours = gradients(other, "cpu", weights)["convexes.points"][0]
        assert float((ours - theirs[list(order)]).norm()) <= GRADIENT * float(theirs.norm()), order


@pytest.mark.parametrize("count", range(3, 9))
def test_each_point_behind_the_camera_while_the_centroid_is_in_front(count: int) -> None:
    """Whichever of the K points it is, the convex is culled alone and the others keep their picture to the last bit."""
    crowd = random_scene(32, gaussians=4, convexes=5, points=count, degree=None).to(torch.float32)
    assert crowd.convexes is not None
    faint = crowd.convexes.opacities.clone()
    faint[1] = 0
    want = crowd.having({"convexes.opacities": faint}).render("cpu")
    behind = crowd.camera.cam_from_world[2, :3] * -4.5  # z = 4 - 4.5 up to the turn
    for k in range(count):
        points = crowd.convexes.points.clone()
        points[1, k] = behind
        scene = crowd.having({"convexes.points": points})
        centroid = crowd.camera.cam_from_world[2, :3] @ points[1].mean(0) + crowd.camera.cam_from_world[2, 3]
        assert float(centroid) > crowd.camera.near
        got = scene.render("cpu")
        assert torch.equal(got.color, want.color) and not bool(got.visible_convexes[1])
        found = gradients(scene, "cpu", {"color": torch.ones_like(got.color)})["convexes.points"]
        assert not found[1].any() and bool(found.any())
