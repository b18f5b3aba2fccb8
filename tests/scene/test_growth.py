"""Where Gaussians are added: who is split if not all can be."""

from types import SimpleNamespace

import numpy as np
import pytest
import torch
from e4dgs.scene.model import Model
from e4dgs.scene.motion.lifetimes.lifetimes import Lifetimes
from e4dgs.scene.motion.phases import Phase
from e4dgs.scene.primitives import ConvexSet, GaussianSet
from e4dgs.scene.settings import TrainingSettings
from e4dgs.scene.training.control.density import Responsibility
from e4dgs.scene.training.control.growth import DensityControl

BRIEF, STAYS = 0, 1
STEP, STEPS = 700, 1000  # in the last round of growth
LIFE = 0.25  # share of the views in which the brief one is present


def split_first(error_of_brief: float, several: bool, most: int | None = None) -> int:
    """Which of two Gaussians, of which the second stays throughout and has an error of 1, is split if only one can be. error_of_brief: mean
    over the views of its life."""
    gaussians = GaussianSet.from_points(np.array([[-0.5, 0, 3.0], [0.5, 0, 3.0]]), np.zeros((2, 3)), 0, opacity=0.8)
    replaced = []
    learned = SimpleNamespace(
        model=Model(gaussians, ConvexSet.empty(6, 0), Lifetimes(9), 0), replace=lambda made, rows, step: replaced.append(rows)
    )
    none, phase = torch.zeros(0), Phase("deformation", STEPS)
    found = Responsibility(torch.ones(2), none, torch.tensor([error_of_brief, 1.0]), none, torch.tensor([LIFE, 1.0]), none, torch.zeros(2))
    control = DensityControl(
        learned,
        views=SimpleNamespace(),
        curriculum=SimpleNamespace(several=several, times=range(60), probe=lambda step, count: [0]),
        settings=TrainingSettings(),
        recipe=Lifetimes.recipe,
        phases=[phase],
        budget=2,
        grow=True,
        event=lambda words: None,
        measure=lambda *given: found,
        most=most,
    )
    control.round(STEP, phase)
    (rows,) = replaced
    (kept,) = rows[rows >= 0].tolist()
    return BRIEF if kept == STAYS else STAYS


def test_a_limit_on_all_holds_where_few_are_present_at_one_time():
    """The two Gaussians of `split_first` fill a budget of 2 only in part, since one is there for a share of the time."""
    assert split_first(1.01, True) == BRIEF
    with pytest.raises(ValueError, match="not enough values"):
        split_first(1.01, True, most=2)


@pytest.mark.parametrize(
    ("error_of_brief", "several", "expected"),
    [
        (1.01, True, BRIEF),
        (0.99, True, STAYS),
        (1.01 / LIFE**0.5, False, BRIEF),
        (0.99 / LIFE**0.5, False, STAYS),
    ],
)
def test_before_one_camera_a_brief_life_must_err_more_to_be_split_first(error_of_brief, several, expected):
    assert split_first(error_of_brief, several) == expected
