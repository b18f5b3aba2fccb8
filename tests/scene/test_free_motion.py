"""Primitives with a life of their own: where they are, when they fade, and that all of it can be learned and saved."""

import math

import numpy as np
import pytest
import torch
from e4dgs.rasterizer import Camera
from e4dgs.scene.model import Model
from e4dgs.scene.motion.lifetimes.at_frame import at_frame, at_frame_reference, turned_by
from e4dgs.scene.motion.lifetimes.lifetime import ALWAYS, Lifetime, set_lifetime
from e4dgs.scene.motion.lifetimes.lifetimes import MOST_PACE, PACE, Lifetimes
from e4dgs.scene.primitives import ConvexSet, GaussianSet
from e4dgs.scene.rotation import quats_to_matrices
from e4dgs.scene.settings import TrainingSettings
from e4dgs.scene.training.control.density import measure_responsibility, survivors
from e4dgs.scene.training.control.learned_model import LearnedModel
from e4dgs.scene.views import Views

TIMES = 11


Given = tuple[torch.Tensor, torch.Tensor | None, torch.Tensor, Lifetime, torch.Tensor]


def given(n: int = 7, corners: int = 1, seed: int = 1, still: float = 0.0) -> Given:
    """Points, quaternions (of Gaussians, whose points are single), opacities, lives, which are dynamic (all but a share of ``still``)."""
    draw = torch.Generator().manual_seed(seed)

    def normal(*shape: int) -> torch.Tensor:
        return torch.randn(*shape, generator=draw, dtype=torch.float64)

    life = Lifetime(
        torch.rand(n, generator=draw, dtype=torch.float64) * (TIMES - 1),
        torch.rand(n, generator=draw, dtype=torch.float64),
        normal(n, 3),
        0.3 * normal(n, 3) * (torch.arange(n) % 5 > 0)[:, None],  # every fifth does not turn
    )
    opacities = torch.rand(n, generator=draw, dtype=torch.float64)
    dynamic = torch.rand(n, generator=draw) >= still
    return normal(n, corners, 3), normal(n, 4) if corners == 1 else None, opacities, life, dynamic


def test_at_the_middle_of_its_life_a_primitive_is_at_rest_and_whole():
    for corners in (1, 4):
        points, quats, opacities, life, dynamic = given(corners=corners)
        for k in (0, 3, 6):
            moved, turned, shown = at_frame_reference(points, quats, opacities, life, dynamic, float(life.times[k]))
            assert torch.allclose(moved[k], points[k]) and float(shown[k]) == pytest.approx(float(opacities[k]))
            assert turned is None or torch.allclose(turned[k], quats[k])


def test_it_drifts_by_its_velocity_and_fades_as_a_bell():
    points, quats, opacities, life, dynamic = given()
    frame = 3.7
    age = frame - life.times
    moved, _, shown = at_frame_reference(points, quats, opacities, life, dynamic, frame)
    assert torch.allclose(moved[:, 0], points[:, 0] + life.velocities * age[:, None])
    assert torch.allclose(shown, opacities * torch.exp(-0.5 * (age / life.log_spans.exp()) ** 2))


def test_a_convex_turns_as_one_about_its_middle():
    points, _, opacities, life, dynamic = given(corners=4)
    frame = 8.0
    moved, _, _ = at_frame_reference(points, None, opacities, life, dynamic, frame)
    age = frame - life.times
    turn = quats_to_matrices(turned_by(life.spins * age[:, None]))
    for k in range(len(points)):
        centre = points[k].mean(0)
        arms = (points[k] - centre) @ turn[k].T
        assert torch.allclose(moved[k], centre + arms + life.velocities[k] * age[k])


def results(given: Given, dtype: torch.dtype, function, frame: float = 4.2) -> dict[str, torch.Tensor]:
    """Outputs and all gradients of a fixed weighting of them."""
    points, quats, opacities, life, dynamic = given
    named = {"points": points, "opacities": opacities, **life._asdict()} | ({} if quats is None else {"quats": quats})
    leaves = {name: p.to(dtype).clone().requires_grad_() for name, p in named.items()}
    own = Lifetime(*(leaves[name] for name in Lifetime._fields))
    moved, turned, shown = function(leaves["points"], leaves.get("quats"), leaves["opacities"], own, dynamic, frame)
    outputs = {"moved": moved, "shown": shown} | ({} if turned is None else {"turned": turned})
    draw = torch.Generator().manual_seed(5)
    weights = [torch.randn(p.shape, generator=draw, dtype=torch.float64).to(dtype) for p in outputs.values()]
    torch.autograd.backward(list(outputs.values()), weights)
    return {name: p.detach() for name, p in outputs.items()} | {"g_" + name: p.grad for name, p in leaves.items()}


@pytest.mark.parametrize("still", [0.0, 0.4])
@pytest.mark.parametrize(("n", "corners"), [(1, 1), (500, 1), (1, 6), (300, 3), (300, 8)])
def test_the_kernel_agrees_with_the_oracle(n, corners, still):
    one = given(n, corners, still=still)
    fast, exact = results(one, torch.float32, at_frame), results(one, torch.float64, at_frame_reference)
    assert fast.keys() == exact.keys()
    for name, expected in exact.items():
        assert torch.allclose(fast[name].double(), expected, rtol=1e-5, atol=1e-5 * float(1 + expected.abs().amax())), name


@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-4, 0.0999, 0.1001, 0.5, 3.0, 12.0])
def test_turns_of_any_size_have_exact_gradients(angle):
    """Around the half angle of 0.1 the kernel changes from a series to sines and cosines."""
    points, quats, opacities, life, dynamic = given(20)
    axis = torch.nn.functional.normalize(torch.randn(20, 3, generator=torch.Generator().manual_seed(2)).double(), dim=1)
    life = life._replace(times=torch.full((20,), 3.2).double(), spins=2 * angle * axis)  # one frame before the moment
    one = points, quats, opacities, life, dynamic
    exact = results(one, torch.float64, at_frame_reference)
    for name, value in results(one, torch.float32, at_frame).items():
        expected = exact[name]
        if angle < 1e-7 and name == "g_spins":  # the oracle is constant so close to zero; here its limit
            expected = results((points, quats, opacities, life._replace(spins=2e-5 * axis), dynamic), torch.float64, at_frame_reference)[
                name
            ]
        assert torch.allclose(value.double(), expected, rtol=2e-5, atol=2e-5 * float(1 + expected.abs().amax())), name


def test_any_number_of_threads_gives_the_same_bits():
    before = torch.get_num_threads()
    runs = []
    try:
        for threads in (1, 3):
            torch.set_num_threads(threads)
            runs.append(results(given(3000, 1, still=0.3), torch.float32, at_frame) | results(given(1000, 6), torch.float32, at_frame))
    finally:
        torch.set_num_threads(before)
    assert all(torch.equal(value, runs[1][name]) for name, value in runs[0].items())


def test_numbers_that_are_not_finite_stay_with_their_primitive():
    points, quats, opacities, life, dynamic = given(40)
    life.spins[3], life.log_spans[7], life.times[11] = float("nan"), float("-inf"), float("inf")
    for name, value in results((points, quats, opacities, life, dynamic), torch.float32, at_frame).items():
        others = torch.ones(40, dtype=torch.bool)
        others[[3, 7, 11]] = False
        assert torch.isfinite(value[others]).all(), name


def test_what_is_not_dynamic_is_copied_and_its_life_has_no_gradient():
    one = given(200, still=0.5)
    still = ~one[4]
    found = results(one, torch.float32, at_frame)
    assert torch.equal(found["moved"][still], one[0].float()[still]) and torch.equal(found["shown"][still], one[2].float()[still])
    assert all(not found["g_" + name][still].any() and found["g_" + name].any() for name in Lifetime._fields)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-3, 1.0, 3.0])
def test_a_rotation_vector_turns_by_its_length(angle):
    vector = torch.tensor([[0.0, 0.0, angle]], dtype=torch.float64, requires_grad=True)
    matrix = quats_to_matrices(turned_by(vector))[0]
    expected = [[math.cos(angle), -math.sin(angle), 0], [math.sin(angle), math.cos(angle), 0], [0, 0, 1]]
    assert torch.allclose(matrix, torch.tensor(expected, dtype=torch.float64), atol=1e-12)
    matrix[1, 0].backward()
    assert vector.grad[0, 2] == pytest.approx(math.cos(angle), abs=1e-6)


@pytest.mark.parametrize("corners", [1, 4])
def test_gradients_agree_with_central_differences(corners):
    points, quats, opacities, life, dynamic = given(5, corners)

    def outputs(points, opacities, *others):
        return [
            p
            for p in at_frame_reference(points, others[4] if quats is not None else None, opacities, Lifetime(*others[:4]), dynamic, 4.2)
            if p is not None
        ]

    inputs = [p.clone().requires_grad_() for p in (points, opacities, *life, *(() if quats is None else (quats,)))]
    assert torch.autograd.gradcheck(lambda *each: tuple(outputs(*each)), inputs, eps=1e-6, atol=1e-7)


def model() -> Model:
    rng = np.random.default_rng(0)
    gaussians = GaussianSet.from_points(rng.normal(size=(20, 3)) * 0.3, rng.uniform(size=(20, 3)), 1, opacity=0.6)
    set_lifetime(gaussians, torch.arange(20) / 2, 2.0, torch.from_numpy(rng.normal(size=(20, 3)) * 0.05).float())
    gaussians.dynamic[10:] = False
    convexes = ConvexSet.from_points(rng.normal(size=(4, 6, 3)) * 0.2, rng.uniform(size=(4, 3)), 1)
    set_lifetime(convexes, torch.arange(4) * 3.0, 1.5)
    return Model(gaussians, convexes, Lifetimes(TIMES), 1)


def test_what_is_not_dynamic_stays_and_the_rest_comes_and_goes():
    made = model()
    before, _ = made.at(0.0, move=False)
    for t in (0.0, 0.5, 1.0):
        now, hulls = made.at(t)
        assert torch.equal(now.means[10:], before.means[10:]) and torch.equal(now.opacities[10:], before.opacities[10:])
        frame = t * (TIMES - 1)
        presence = torch.exp(-0.5 * ((frame - made.gaussians.times[:10]) / 2.0) ** 2)
        assert torch.allclose(now.opacities[:10], before.opacities[:10] * presence)
        theirs = torch.exp(-0.5 * ((frame - made.convexes.times) / 1.5) ** 2)
        assert torch.allclose(hulls.opacities, made.convexes.opacities * theirs)


def test_a_saved_model_renders_the_same():
    made = model()
    again = Model.from_arrays(made.to_arrays(), made.config)
    K = torch.tensor([[60.0, 0, 32], [0, 60.0, 24], [0, 0, 1]])
    pose = torch.eye(4)
    pose[2, 3] = 3.0
    camera = Camera(K, pose, 64, 48)
    for t in (0.1, 0.9):
        one, two = made.render(camera, t), again.render(camera, t)
        assert torch.equal(one.color, two.color) and float(one.alpha.max()) > 0.1


def test_by_default_primitives_are_there_throughout():
    bare = GaussianSet.from_points(np.zeros((3, 3)), np.zeros((3, 3)), 0)
    assert not set(Lifetime._fields) & set(bare.parameters)
    gaussians = bare.carrying(Lifetimes.attributes)
    assert set(Lifetime._fields) < set(gaussians.parameters)
    _, _, shown = Lifetimes(1000).alive(gaussians, 1.0)
    assert ALWAYS > 1000 and float((shown / gaussians.opacities).detach().min()) > 0.99


@pytest.mark.parametrize("kind", [GaussianSet, ConvexSet])
def test_how_a_primitive_drifts_says_nothing_of_how_it_turns(kind):
    """Velocities and spins begin alike, at zero, and are still two things."""
    rng = np.random.default_rng(0)
    colors = np.zeros((4, 3))
    made = (
        kind.from_points(rng.normal(size=(4, 3)), colors, 0)
        if kind is GaussianSet
        else kind.from_points(rng.normal(size=(4, 6, 3)), colors, 0)
    )
    set_lifetime(made, 0.0, 1.0, torch.ones(4, 3))
    assert float(made.spins.detach().abs().max()) == 0 and float(made.velocities.detach().min()) == 1


def standing(times: int = TIMES) -> Views:
    """One camera that stands, once for each time, before a grey wall."""
    K = np.tile(np.array([[60.0, 0, 32], [0, 60.0, 24], [0, 0, 1]]), (times, 1, 1))
    pose = np.eye(4)
    pose[2, 3] = 3.0
    index = np.arange(times)
    picture = np.full((48, 64, 3), 128, np.uint8)
    return Views(
        K,
        np.tile(pose, (times, 1, 1)),
        np.linspace(0, 1, times),
        np.zeros(times, int),
        np.append(index[1:], -1),
        index,
        64,
        48,
        lambda i: picture,
    )


def test_a_short_life_is_judged_by_the_views_in_it():
    """The first lives around frame 2, the second throughout; both would look alike."""
    gaussians = GaussianSet.from_points(np.array([[-0.5, 0, 0], [0.5, 0, 0]]), np.zeros((2, 3)), 0, opacity=0.8)
    set_lifetime(gaussians, torch.tensor([2.0, 5.0]), 1.0)
    with torch.no_grad():
        gaussians.log_scales.fill_(math.log(0.1))
        gaussians.log_spans[1] = math.log(ALWAYS)
    made = Model(gaussians, ConvexSet.empty(6, 0), Lifetimes(TIMES), 0)
    found = measure_responsibility(made, standing(), list(range(TIMES)), move=True)
    assert float(found.weight_gaussians[0] / found.weight_gaussians[1]) == pytest.approx(1, abs=0.15)
    assert float(found.error_gaussians[0] / found.error_gaussians[1]) == pytest.approx(1, abs=0.15)
    share = np.exp(-0.5 * (np.arange(TIMES) - 2.0) ** 2).mean()
    assert found.life_gaussians.tolist() == pytest.approx([share, 1.0], rel=1e-3)
    without = measure_responsibility(made, standing(), [8, 9, 10], move=True)
    assert torch.isinf(without.weight_gaussians[0]) and torch.isfinite(without.weight_gaussians[1])
    assert float(without.error_gaussians[0]) == 0.0
    assert survivors(made.gaussians, 0.01, without.weight_gaussians, 0.25).tolist() == [0, 1]


def test_opacities_alone_are_those_of_the_whole():
    draw = torch.Generator().manual_seed(4)
    gaussians = GaussianSet.from_points(np.zeros((50, 3)), np.full((50, 3), 0.5), 0)
    set_lifetime(gaussians, (TIMES - 1) * torch.rand(50, generator=draw), 1.7)
    gaussians.dynamic[::3] = False
    motion = Lifetimes(TIMES)
    for t in (0.0, 0.33, 1.0):
        assert torch.allclose(motion.opacities(gaussians, t), motion.alive(gaussians, t)[2], rtol=1e-5, atol=1e-9)


def test_brief_lives_learn_faster():
    """Up to a limit; what is present throughout learns as it does in a static scene."""
    motion = Lifetimes(TIMES)

    def pace(share):
        return float(motion.pace({"log_spans": torch.tensor([math.log(share * TIMES / math.sqrt(2 * math.pi))])})[0])

    assert float(motion.pace({"log_spans": torch.tensor([math.log(ALWAYS)])})[0]) == pace(1.01) == 1
    assert pace(0.99) == pytest.approx(0.99**-PACE) and pace(0.2) == pytest.approx(0.2**-PACE)
    least = MOST_PACE ** (-1 / PACE)
    assert pace(1.01 * least) < pace(0.99 * least) == pace(0.1 * least) == MOST_PACE


@pytest.mark.parametrize("kind", ["gaussians", "convexes"])
def test_a_training_step_moves_brief_lives_farther(kind):
    made = Model(GaussianSet.from_points(np.zeros((2, 3)), np.zeros((2, 3)), 0), ConvexSet.empty(6, 0), Lifetimes(TIMES), 0)
    if kind == "convexes":
        balls = np.random.default_rng(1).normal(size=(2, 6, 3))
        made.convexes = ConvexSet.from_points(balls, np.full((2, 3), 0.5), 0)
    primitives = getattr(made, kind)
    set_lifetime(primitives, torch.tensor([2.0, 5.0]), 1.0)
    with torch.no_grad():
        primitives.log_spans[1] = math.log(ALWAYS)
    learned = LearnedModel(made, TrainingSettings(), 1.0, 1.0)
    before = {name: p.detach().clone() for name, p in primitives.parameters.items()}
    want = float(made.motion.pace(primitives.parameters)[0])
    for p in primitives.parameters.values():
        p.grad = torch.ones_like(p)
    learned.optimiser.step(0.0)
    for name, p in primitives.parameters.items():
        if p[0].numel():
            brief, long = ((p.detach() - before[name])[row].flatten()[0] for row in (0, 1))
            assert float(brief / long) == pytest.approx(want, rel=2e-3 if name != "log_spans" else 2e-2), name
