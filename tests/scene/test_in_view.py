"""Which Gaussians a view may show: never too few, against the rasterizer itself, and hardly too many."""

import math

import pytest
import torch
from e4dgs.rasterizer import TILE, Camera, Convexes, Frame, Gaussians, rasterize
from e4dgs.scene import _kernels
from e4dgs.scene.model import Model
from e4dgs.scene.motion.in_view import in_view
from e4dgs.scene.motion.lifetimes.lifetimes import Lifetimes
from e4dgs.scene.motion.nodes.control_nodes import ControlNodes
from e4dgs.scene.motion.static import Static
from e4dgs.scene.primitives import ConvexSet, GaussianSet

WIDTH, HEIGHT, TIMES = 150, 90, 9
DEGREE = 1


def looking(near=0.2, far_from_origin=0.0, principal=(75.0, 45.0)) -> Camera:
    pose = torch.eye(4, dtype=torch.float64)
    turn = 0.7
    pose[0, 0] = pose[2, 2] = math.cos(turn)
    pose[0, 2], pose[2, 0] = math.sin(turn), -math.sin(turn)
    pose[:3, 3] = -pose[:3, :3] @ torch.full((3,), far_from_origin, dtype=torch.float64)
    K = torch.tensor([[120.0, 0, principal[0]], [0, 110.0, principal[1]], [0, 0, 1]], dtype=torch.float64)
    return Camera(K, pose, WIDTH, HEIGHT, near)


def scene(n=3000, seed=0, size=-3.0, far_from_origin=0.0) -> GaussianSet:
    """Gaussians on all sides of the camera, of many sizes and opacities, half of them with a life of their own."""
    draw = torch.Generator().manual_seed(seed)

    def normal(*shape):
        return torch.randn(*shape, generator=draw)

    g = GaussianSet(
        {
            "means": 3 * normal(n, 3) + far_from_origin,
            "quats": normal(n, 4),
            "log_scales": size + 1.2 * normal(n, 3),
            "opacity_logits": 3 * normal(n) - 1,
            "sh_dc": normal(n, 1, 3),
            "sh_rest": 0.3 * normal(n, (DEGREE + 1) ** 2 - 1, 3),
            "hyper": torch.zeros(n, 2),
            "shades": torch.zeros(n, 3),
            "times": (TIMES - 1) * torch.rand(n, generator=draw),
            "log_spans": normal(n),
            "velocities": 0.2 * normal(n, 3),
            "spins": 0.3 * normal(n, 3),
        },
        torch.rand(n, generator=draw) < 0.5,
    )
    return g


def model_of(gaussians: GaussianSet, moves=True, antialiased=True) -> Model:
    motion = Lifetimes(TIMES) if moves else Static()
    return Model(gaussians, ConvexSet.empty(6, DEGREE), motion, DEGREE, antialiased=antialiased)


def rendered(shapes: tuple[Gaussians, Convexes], camera: Camera, antialiased=True, tiles=None) -> tuple[Frame, dict[str, torch.Tensor]]:
    """The image, and the gradients of the Gaussians of ``shapes``."""
    leaves = {name: p.detach().requires_grad_() for name, p in vars(shapes[0]).items() if p is not None}
    convexes = Convexes(**{name: None if p is None else p.detach() for name, p in vars(shapes[1]).items()})
    frame = rasterize(camera, Gaussians(**leaves), convexes, antialiased=antialiased, tiles=tiles)
    weight = torch.linspace(-1, 1, WIDTH)[None, :, None] * torch.tensor([1.0, 0.5, -0.7])
    (frame.color * weight).sum().backward()
    return frame, {name: p.grad for name, p in leaves.items()}


def some_tiles(seed: int) -> torch.Tensor:
    draw = torch.Generator().manual_seed(seed)
    return torch.rand(-(-HEIGHT // TILE), -(-WIDTH // TILE), generator=draw) < 0.2


CASES = {
    "moving": {},
    "still": {"moves": False},
    "classic mode": {"antialiased": False},
    "large": {"size": -1.0},
    "small": {"size": -6.0},
    "far from the origin": {"far_from_origin": 3000.0},
    "the principal point beside the image": {"principal": (-60.0, 200.0)},
    "a near plane among them": {"near": 2.0},
}


@pytest.mark.parametrize("case", CASES.values(), ids=CASES)
@pytest.mark.parametrize("drawn", [None, 3], ids=["all tiles", "some tiles"])
def test_image_and_gradients_are_the_same_without_the_others(case, drawn):
    """Bit-equal, because the others reach no pixel. This fails if the selection leaves out a single one that does."""
    places = {k: v for k, v in case.items() if k in ("size", "far_from_origin")}
    camera = looking(**{k: v for k, v in case.items() if k in ("near", "far_from_origin", "principal")})
    tiles = None if drawn is None else some_tiles(drawn)
    for seed in range(3):
        whole = model_of(scene(seed=seed, **places), **{k: v for k, v in case.items() if k in ("moves", "antialiased")})
        t = 0.3 * seed
        rows = whole.in_view(t, camera, tiles)
        gaussians, convexes = whole.at(t, camera)
        chosen = Gaussians(**{name: None if p is None else p[rows] for name, p in vars(gaussians).items()})
        expected, grads = rendered((gaussians, convexes), camera, whole.antialiased, tiles)
        found, mine = rendered((chosen, convexes), camera, whole.antialiased, tiles)
        assert torch.equal(found.color, expected.color) and torch.equal(found.depth, expected.depth)
        others = torch.ones(len(whole.gaussians), dtype=torch.bool)
        others[rows] = False
        assert all(torch.equal(mine[name], grads[name][rows]) and not grads[name][others].any() for name in mine)


@pytest.mark.parametrize("moves", [True, False])
def test_a_model_of_the_chosen_ones_shows_the_same(moves):
    whole, camera = model_of(scene(), moves), looking()
    part = whole.with_gaussians(whole.gaussians.select(whole.in_view(0.4, camera)))
    # Not bit-equal: torch's exp and sigmoid round differently at other places of a tensor.
    assert torch.allclose(part.render(camera, 0.4).color, whole.render(camera, 0.4).color, atol=2e-6)


@pytest.mark.parametrize("drawn", [None, 3], ids=["all tiles", "some tiles"])
def test_hardly_more_are_chosen_than_the_image_shows(drawn):
    """Of small, round ones: few hide others, and how an elongated one lies is not looked at. Nor is how faint they are."""
    tiles = None if drawn is None else some_tiles(drawn)
    gaussians = scene(n=20_000, size=-5.0)
    with torch.no_grad():
        gaussians.log_scales[:] = gaussians.log_scales[:, :1]
    model = model_of(gaussians)
    visible = int(rendered(model.at(0.5), looking(), True, tiles)[0].visible_gaussians.sum())
    chosen = len(model.in_view(0.5, looking(), tiles))
    assert visible > 300 and visible <= chosen <= (1.35 if drawn is None else 1.8) * visible


def one(**given) -> GaussianSet:
    g = GaussianSet.from_points(torch.tensor([[0.0, 0.0, 0.0]]).numpy(), torch.full((1, 3), 0.5).numpy(), DEGREE, max_scale=0.01)
    g = g.carrying(Lifetimes.attributes)
    with torch.no_grad():
        for name, value in given.items():
            g.parameters[name][:] = torch.tensor(value)
    return g


def straight(near=0.2) -> Camera:
    K = torch.tensor([[100.0, 0, 75.0], [0, 100.0, 45.0], [0, 0, 1]])
    return Camera(K, torch.eye(4), WIDTH, HEIGHT, near)


@pytest.mark.parametrize(("z", "seen"), [(0.2001, True), (0.1999, False), (-1.0, False)])
def test_the_near_plane(z, seen):
    assert (len(in_view(one(means=[[0.0, 0.0, z]]), straight())) == 1) == seen


@pytest.mark.parametrize(("opacity", "seen"), [(1.001 / 255, True), (0.995 / 255, False)])
def test_the_faintest(opacity, seen):
    logit = math.log(opacity / (1 - opacity))
    assert (len(in_view(one(means=[[0.0, 0.0, 1.0]], opacity_logits=[logit]), straight())) == 1) == seen


def test_a_life_decides_when_and_where():
    # Fades to 1/255 of its opacity of nearly 1 after 3.3 of its spans, and crosses the image in between.
    g = one(means=[[0.0, 0.0, 1.0]], opacity_logits=[9.0], times=[4.0], log_spans=[0.0], velocities=[[0.1, 0.0, 0.0]])
    assert [frame for frame in range(9) if len(in_view(g, straight(), float(frame)))] == [1, 2, 3, 4, 5, 6, 7]
    fast = one(means=[[0.0, 0.0, 1.0]], opacity_logits=[9.0], times=[4.0], log_spans=[0.0], velocities=[[0.5, 0.0, 0.0]])
    assert [frame for frame in range(9) if len(in_view(fast, straight(), float(frame)))] == [3, 4, 5]
    g.dynamic[:] = False
    assert all(len(in_view(g, straight(), float(frame))) for frame in range(9))


def test_only_drawn_tiles_count():
    g = one(means=[[0.0, 0.0, 1.0]], log_scales=[[-6.0] * 3])  # pixel (75, 45): tile row 2, column 4
    tiles = torch.zeros(6, 10, dtype=torch.bool)
    assert not len(in_view(g, straight(), tiles=tiles))
    tiles[2, 4] = True
    assert len(in_view(g, straight(), tiles=tiles)) == 1
    tiles[2, 4], tiles[2, 3] = False, True
    assert not len(in_view(g, straight(), tiles=tiles))


def test_values_that_are_not_finite_are_left_out_and_nothing_else():
    for name, value in (("means", math.nan), ("log_scales", math.nan), ("opacity_logits", math.nan), ("means", math.inf)):
        g = scene(600)
        with torch.no_grad():
            g.parameters[name][5] = value
        expected = in_view(scene(600), looking())
        found = in_view(g, looking())
        assert 5 not in found.tolist() and set(found.tolist()) == set(expected.tolist()) - {5}


def test_the_result_is_sorted_and_does_not_depend_on_threads():
    g, before = scene(5000), torch.get_num_threads()
    try:
        found = []
        for threads in (1, 2, 5):
            torch.set_num_threads(threads)
            found.append(in_view(g, looking(), 3.5, some_tiles(1)))
    finally:
        torch.set_num_threads(before)
    assert all(torch.equal(found[0], other) for other in found)
    assert bool((found[0][1:] > found[0][:-1]).all())


def test_no_gaussians_and_none_in_view():
    empty = GaussianSet.from_points(torch.zeros(0, 3).numpy(), torch.zeros(0, 3).numpy(), DEGREE)
    assert len(in_view(empty, straight())) == 0
    behind = model_of(one(means=[[0.0, 0.0, -1.0]]))
    rows = behind.in_view(0.5, straight())
    assert len(rows) == 0
    part = behind.with_gaussians(behind.gaussians.select(rows))
    assert not rasterize(straight(), *part.at(0.5), antialiased=True).alpha.any()


def test_motion_that_has_to_be_computed_first_is_not_asked():
    gaussians = scene(400)
    model = model_of(gaussians)
    model.motion = ControlNodes.over(gaussians.means.detach().numpy())
    assert model.in_view(0.5, looking()) is None


def test_wrong_shapes_are_refused():
    g = scene(10)
    args = g.means.detach(), g.log_scales.detach(), g.opacity_logits.detach(), [], g.dynamic, 0.0, 1.0
    camera, index = torch.zeros(17, dtype=torch.float64), torch.empty(10, dtype=torch.int64)
    for bad, match in (
        ((args[0][:5], *args[1:], camera, 8, 8, None, TILE, index, 1), "log_scales must be"),
        ((*args, camera[:16], 8, 8, None, TILE, index, 1), "camera must be"),
        ((*args, camera, 8, 8, torch.ones(2, 2, dtype=torch.bool), TILE, index, 1), "tiles must cover"),
        ((*args, camera, 8, 8, None, TILE, index[:9], 1), "index must be"),
    ):
        with pytest.raises(ValueError, match=match):
            _kernels.in_view(*bad)
