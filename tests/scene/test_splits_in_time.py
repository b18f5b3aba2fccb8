"""A Gaussian that is too bright at some times and too dark at others: it is split into two lives."""

from collections.abc import Callable
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from e4dgs.scene.losses.term import Measured
from e4dgs.scene.model import Model
from e4dgs.scene.motion.lifetimes.at_frame import presence
from e4dgs.scene.motion.lifetimes.lifetime import lifetime, set_lifetime
from e4dgs.scene.motion.lifetimes.lifetimes import Lifetimes
from e4dgs.scene.motion.phases import Phase
from e4dgs.scene.motion.static import Static
from e4dgs.scene.primitives import ConvexSet, GaussianSet
from e4dgs.scene.settings import TrainingSettings
from e4dgs.scene.training.control import growth
from e4dgs.scene.training.control.density import Responsibility, measure_responsibility
from e4dgs.scene.training.control.growth import IN_TIME, IN_TIME_FROM, IN_TIME_UNSEEN, DensityControl
from e4dgs.scene.training.control.splits import split
from e4dgs.scene.training.trainer import Trainer
from e4dgs.scene.views import Views

TIMES, STEPS = 9, 1000


def one(dynamic: bool = False) -> GaussianSet:
    gaussians = GaussianSet.from_points(np.array([[0.0, 0, 3]]), np.full((1, 3), 0.5), 0, opacity=0.8).carrying(Lifetimes.attributes)
    with torch.no_grad():
        gaussians.log_scales.fill_(np.log(0.3))
        if dynamic:
            gaussians.log_spans.fill_(np.log(2.0))
    return GaussianSet(gaussians.parameters, torch.tensor([dynamic]))


def in_front_of(pictures: list[np.ndarray]) -> Views:
    """A still camera that sees ``pictures``, one a time."""
    n, index = len(pictures), np.arange(len(pictures))
    K = np.tile(np.array([[40.0, 0, 24], [0, 40.0, 20], [0, 0, 1]]), (n, 1, 1))
    poses, following = np.tile(np.eye(4), (n, 1, 1)), np.append(index[1:], -1)
    return Views(K, poses, np.linspace(0, 1, n), index * 0, following, index, 48, 40, pictures.__getitem__)


def varying(levels: list[int]) -> float:
    """The measured share for a grey Gaussian that fills grey pictures of these ``levels``."""
    gaussians = one()
    with torch.no_grad():
        gaussians.log_scales.fill_(np.log(20.0))
        gaussians.opacity_logits.fill_(6.0)
    model = Model(gaussians, ConvexSet.empty(6, 0), Lifetimes(len(levels)), 0)
    views = in_front_of([np.full((40, 48, 3), level, np.uint8) for level in levels])
    return float(measure_responsibility(model, views, list(range(len(levels))), move=True).varying_gaussians[0])


def test_error_that_changes_its_sign_over_time_is_measured():
    assert varying([255] * 4) == pytest.approx(0, abs=1e-5)
    assert varying([0, 255, 0, 255]) == pytest.approx(1, abs=0.05)
    assert varying([0, 255, 255, 255]) == pytest.approx(0.5, abs=0.05)


def test_without_lives_nothing_is_measured():
    model = Model(one(), ConvexSet.empty(6, 0), Static(), 0)
    views = in_front_of([np.full((40, 48, 3), level, np.uint8) for level in (0, 255)])
    assert measure_responsibility(model, views, [0, 1], move=False).varying_gaussians.tolist() == [0.0]


def present(lives: GaussianSet, frame: float) -> float:
    """How opaque ``lives`` are together."""
    return 1 - float((1 - lives.opacities * presence(lifetime(lives), frame)).detach().prod())


def test_who_stays_gets_two_lives_at_its_place_that_cover_all_times():
    three = GaussianSet.joined([one(), one(dynamic=True), one()])
    made, source = split(three, torch.tensor([1]), torch.tensor([0]), Lifetimes(TIMES).halves_in_time)
    assert source.tolist() == [2, -1, -1, -1, -1] and made.dynamic.tolist() == [False, True, True, True, True]
    lives = made.select(torch.tensor([3, 4]))
    for name in ("means", "quats", "log_scales", "opacity_logits", "sh_dc"):
        assert torch.equal(lives.parameters[name], three.parameters[name][:1].expand_as(lives.parameters[name])), name
    early, late = lives.times.tolist()
    assert 0 < early < (TIMES - 1) / 2 < late < TIMES - 1
    assert all(0.55 < present(lives, frame) < 0.86 for frame in range(TIMES)), "nearly as opaque as before, 0.8"


def test_the_halves_of_a_life_stay_on_its_course():
    parent = one(dynamic=True)
    set_lifetime(parent, 4.0, 2.0, torch.tensor([[0.1, 0.0, -0.2]]))
    with torch.no_grad():
        parent.spins[:] = torch.tensor([0.0, 0.3, 0.1])
    (early, late), motion = Lifetimes(40).halves_in_time(parent), Lifetimes(40)
    assert early.times.item() < 4 < late.times.item() and early.log_spans.item() < parent.log_spans.item()
    both = GaussianSet.joined([early, late])
    assert present(both, 4.0) == pytest.approx(present(parent, 4.0), abs=0.02)
    for frame in (2.0, 4.0, 7.0):
        place, turned, _ = motion.alive(parent, frame / 39)
        for half in (early, late):
            there, there_turned, _ = motion.alive(half, frame / 39)
            assert torch.allclose(there, place, atol=1e-5) and torch.allclose(there_turned, turned, atol=1e-5)
        assert present(both, frame) == pytest.approx(present(parent, frame), abs=0.21)


def masks(shown: list[bool], place: int = 0) -> Callable[[int], torch.Tensor | None]:
    """Of frames of `in_front_of`: a strip of moving pixels as wide as an eighth of the picture, ``place`` eighths from the middle, in the
    frames where ``shown``; the others have no mask, or an empty one."""

    def moving(i: int) -> torch.Tensor | None:
        mask = torch.zeros(4, 9, dtype=torch.bool)
        mask[:, 4 + place] = shown[i]
        return mask if shown[i] or i % 2 else None

    return moving


def round_of(
    share: float,
    step: int = 700,
    dynamic: bool = False,
    several: bool = False,
    times: int = 16,
    moving: Callable[[int], torch.Tensor | None] | None = None,
) -> GaussianSet:
    """What a round at ``step`` makes of one Gaussian in the middle of the pictures, of whose error ``share`` changes sign."""
    made = []
    learned = SimpleNamespace(
        model=Model(one(dynamic), ConvexSet.empty(6, 0), Lifetimes(TIMES), 0), replace=lambda gaussians, rows, step: made.append(gaussians)
    )
    none, single = torch.zeros(0), torch.ones(1)
    found = Responsibility(single, none, single, none, single, none, torch.tensor([share]))
    phase = Phase("deformation", STEPS)
    curriculum = SimpleNamespace(several=several, times=np.linspace(0, 1, times), probe=lambda step, count: [0, 1, 2, 3])
    views = in_front_of([np.zeros((40, 48, 3), np.uint8)] * 4)
    control = DensityControl(
        learned, views, curriculum, TrainingSettings(), Lifetimes.recipe, [phase], 9, True, lambda words: None, lambda *given: found, moving
    )
    control.round(step, phase)
    return made[0]


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ({"share": IN_TIME + 0.01}, True),
        ({"share": IN_TIME - 0.01}, False),
        ({"share": 0.9, "step": round(IN_TIME_FROM * STEPS)}, False),
        ({"share": 0.9, "step": round(IN_TIME_FROM * STEPS) + 1}, True),
        ({"share": 0.9, "dynamic": True}, True),
        ({"share": 0.9, "several": True}, False),
        ({"share": 0.9, "times": 15}, False),
        ({"share": IN_TIME_UNSEEN - 0.01, "moving": masks([False] * 4)}, False),  # at rest, and nothing moves there: the shape is wrong
        ({"share": IN_TIME_UNSEEN + 0.01, "moving": masks([False] * 4)}, True),  # no shape explains so much
        ({"share": IN_TIME + 0.01, "moving": masks([True, False, False, False])}, False),  # something passes in front of it
        ({"share": IN_TIME + 0.01, "moving": masks([True, True, False, False])}, True),
        ({"share": IN_TIME - 0.01, "moving": masks([True] * 4)}, False),
        ({"share": IN_TIME + 0.01, "moving": masks([True] * 4, place=2)}, False),  # beside it
        ({"share": IN_TIME + 0.01, "moving": masks([False] * 4), "dynamic": True}, True),  # who has a life of its own goes on as before
    ],
)
def test_when_it_is_split_in_time(given, expected):
    made = round_of(**given)
    assert len(made) == 2
    apart_in_time = float((made.times[1] - made.times[0]).detach()) > 1
    apart_in_space = float((made.means[1] - made.means[0]).detach().norm()) > 0
    assert (apart_in_time, apart_in_space) == (expected, not expected)
    assert bool(made.dynamic.all()) == (expected or given.get("dynamic", False))


@pytest.mark.parametrize(("moves", "lives"), [(True, True), (False, False)])
def test_training_asks_the_masks_whether_something_moves(moves, lives, monkeypatch):
    """A wall that flickers. If only masks count and show nothing, its Gaussians stay throughout."""
    monkeypatch.setattr(growth, "IN_TIME_UNSEEN", 1.0)
    views = in_front_of([np.full((40, 48, 3), 255 * (k % 2), np.uint8) for k in range(16)])
    gaussians = GaussianSet.joined([one(), one()])
    with torch.no_grad():
        gaussians.log_scales.fill_(np.log(20.0))
    model = Model(gaussians, ConvexSet.empty(6, 0), Lifetimes(16), 0)
    mask = torch.full((10, 12), moves)
    Trainer(
        model,
        views,
        [Phase("deformation", 280, move=True)],
        TrainingSettings(),
        8,
        measured=Measured(moving=lambda i: mask),
        recipe=Lifetimes.recipe,
    ).run()
    assert len(model.gaussians) > 2 and bool(model.gaussians.dynamic.any()) is lives
