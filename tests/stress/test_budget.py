"""The budget of primitives holds at every round of density control, however often and from wherever it is run."""

import numpy as np
import pytest
import torch
from e4dgs.scene.model import Model
from e4dgs.scene.motion.phases import Phase
from e4dgs.scene.motion.static import Static
from e4dgs.scene.primitives import ConvexSet, GaussianSet
from e4dgs.scene.settings import TrainingSettings
from e4dgs.scene.training.control.growth import GAUSSIANS_PER_PIXEL
from e4dgs.scene.training.trainer import Trainer
from e4dgs.scene.views import Views

SIZE, COUNT = 24, 40


def trainer(budget: int, scale: float = 1.0) -> tuple[Trainer, Phase]:
    """Of 40 Gaussians before three cameras whose images are all wrong, so that every round wants to add as many as it may."""
    rng = np.random.default_rng(0)
    K, pose = np.array([[30.0, 0, SIZE / 2], [0, 30, SIZE / 2], [0, 0, 1]]), np.eye(4)
    pose[2, 3] = 4.0
    images = rng.integers(0, 255, (3, SIZE, SIZE, 3), dtype=np.uint8)
    index = np.arange(3)
    views = Views(
        np.repeat(K[None], 3, 0), np.repeat(pose[None], 3, 0), np.zeros(3), index, np.full(3, -1), index, SIZE, SIZE, lambda i: images[i]
    )
    gaussians = GaussianSet.from_points(rng.uniform(-1, 1, (COUNT, 3)), np.full((COUNT, 3), 0.5), 0, max_scale=0.3)
    phase = Phase("all", 100, move=False, scale=scale)
    settings = TrainingSettings(iterations=100, sh_degree=0, min_contribution=0.0)
    return Trainer(Model(gaussians, ConvexSet.empty(6, 0), Static(), 0), views, [phase], settings, budget), phase


@pytest.mark.parametrize("budget", [1, COUNT - 1, COUNT, COUNT + 1, COUNT + 7, 3 * COUNT, 10 * COUNT])
def test_primitive_budget_respected(budget: int) -> None:
    train, phase = trainer(budget)
    sizes = []
    for step in range(12):
        train.density.round(step, phase)
        sizes.append(len(train.model.gaussians))
    assert max(sizes) <= max(budget, COUNT)  # what is there already is not thrown away
    assert budget <= COUNT or max(sizes) > 0.9 * budget  # and what is allowed is used
    assert all(bool(torch.isfinite(p).all()) for p in train.model.gaussians.parameters.values())


def test_small_images_have_a_budget_of_their_own() -> None:
    train, phase = trainer(10_000, scale=0.5)
    for step in range(12):
        train.density.round(step, phase)
    assert COUNT < len(train.model.gaussians) <= round(GAUSSIANS_PER_PIXEL * (SIZE // 2) ** 2)
