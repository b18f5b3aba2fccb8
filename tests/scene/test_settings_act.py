"""Every setting that a training stage offers does something there."""

import numpy as np
import pytest
import torch
from e4dgs.scene.losses.term import Measured
from e4dgs.scene.motion.phases import Phase
from e4dgs.scene.settings import GrowthSettings, RefinementSettings
from e4dgs.scene.training.trainer import Trainer
from sliding_gaussians import SETTINGS, fresh, make_views

SIZE = 16
BY_STAGES = {"iterations", "budget"}  # stages read these themselves, and hand over phases and a number of Gaussians


class Asked:
    """Settings that know which of them were asked for."""

    def __init__(self, settings) -> None:
        self._settings, self.names = settings, set()

    def __getattr__(self, name):
        self.names.add(name)
        return getattr(self._settings, name)


@pytest.mark.parametrize("grow", [False, True])
def test_training_reads_what_it_is_told_and_growth_only_where_there_is_any(grow, tmp_path):
    views = make_views(cameras=4, times=3, size=SIZE)
    views.load_alpha = lambda i: np.full((SIZE, SIZE), 255, np.uint8)
    flow = torch.zeros(SIZE // 2, SIZE // 2, 2), torch.ones(SIZE // 2, SIZE // 2)
    settings = Asked(SETTINGS)
    Trainer(fresh(views), views, [Phase("refinement", 240)], settings, 80, tmp_path, grow=grow, measured=Measured(lambda i: flow)).run()
    offered = set(RefinementSettings.model_fields) | (set(GrowthSettings.model_fields) if grow else set())
    assert settings.names == offered - BY_STAGES
