"""Steps that draw only the window that alpha fills minimise what steps that draw the whole image do."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from e4dgs.scene.losses.measured_depth import MeasuredDepth
from e4dgs.scene.losses.surface import Surface
from e4dgs.scene.losses.term import Measured, Now, Run
from e4dgs.scene.motion.planes.field import DeformationField
from sliding_gaussians import SETTINGS, make_views

SIZE, UNIT = 96, 4.0
LEFT, TOP, RIGHT, BOTTOM = WINDOW = (20, 10, 84, 58)


@pytest.mark.parametrize("scale", [1.0, 0.5])
@pytest.mark.parametrize(("smooth", "depth"), [(1.0, 0.0), (0.0, 1.0)], ids=["smoothness", "measured depth"])
def test_terms_on_depth_are_the_same(smooth, depth, scale):
    views = replace(make_views(cameras=4, times=2, size=SIZE), load_alpha=lambda i: np.zeros((SIZE, SIZE), np.uint8))
    moving = torch.zeros(SIZE // 4, SIZE // 4, dtype=torch.bool)
    moving[:, 10:14] = True
    inverse = torch.linspace(0.1, 0.4, SIZE).expand(SIZE, SIZE).contiguous()
    known = MeasuredDepth({0: inverse}, UNIT, lambda i: moving)
    settings = SETTINGS.model_copy(update={"depth_weight": depth, "smooth_weight": smooth})
    term = Surface(Run(views, settings, DeformationField.recipe, UNIT, True, 100, 0, Measured(depth=known)))
    size = round(SIZE * scale)
    left, top, right, bottom = window = tuple(round(edge * scale) for edge in WINDOW)
    inside = slice(top, bottom), slice(left, right)
    draw = torch.Generator().manual_seed(0)
    distance, alpha, target = 3 + torch.rand(size, size, generator=draw), torch.zeros(size, size), torch.full((size, size, 3), 0.5)
    alpha[top + 2 : bottom - 2, left + 2 : right - 2] = 1.0

    def value(where, window):
        frame = SimpleNamespace(depth=distance[where].contiguous(), alpha=alpha[where].contiguous())
        rendered = SimpleNamespace(frame=frame, target=target[where].contiguous(), weight=None, size=(size, size))
        return term.value(rendered, term.inputs(None, Now(0, 0, scale, True, window)))

    whole, part = value(slice(None), None), value(inside, window)
    assert float(part) == pytest.approx(float(whole), rel=0.05 if smooth else 1e-5) and float(whole) > 1e-3
