"""A model that was trained for the antialiased mode is drawn in it everywhere."""

import numpy as np
import pytest
import torch
from e4dgs.rasterizer import rasterize
from e4dgs.scene.losses.flow_loss import rendered_flow
from e4dgs.scene.model import Model
from e4dgs.scene.motion.phases import Phase
from e4dgs.scene.motion.static import Static
from e4dgs.scene.primitives import ConvexSet, GaussianSet
from e4dgs.scene.training.checkpoint import model_of
from e4dgs.scene.training.control.density import measure_responsibility
from e4dgs.scene.training.trainer import Trainer
from e4dgs.stages.hulls.edge_seeds import edge_seeds
from sliding_gaussians import SETTINGS, make_views


def tiny(antialiased):
    """Gaussians much smaller than a pixel, where the two modes differ most."""
    rng = np.random.default_rng(2)
    gaussians = GaussianSet.from_points(rng.uniform(-0.8, 0.8, (50, 3)), rng.random((50, 3)), 0, opacity=0.9, max_scale=0.004)
    return Model(gaussians, ConvexSet.empty(6, 0), Static(), 0, antialiased=antialiased)


@pytest.fixture(scope="module")
def views():
    return make_views()


@pytest.mark.parametrize("antialiased", [False, True])
def test_every_render_uses_the_mode_of_the_model(views, antialiased):
    model, camera = tiny(antialiased), views.rasterizer_camera(0)
    drawn, other = (rasterize(camera, *model.at(0.0), torch.zeros(3), antialiased=mode) for mode in (antialiased, not antialiased))
    assert torch.equal(model.render(camera, 0.0).color, drawn.color)
    assert float((drawn.alpha.sum() - other.alpha.sum()).abs()) > 0.5 * float(drawn.alpha.sum())
    weight = measure_responsibility(model, views, [0], move=False).weight_gaussians
    assert float(weight.sum()) == pytest.approx(float(drawn.alpha.sum()), rel=1e-3)
    assert edge_seeds(model, views, [0]).weight.sum() == pytest.approx(float(drawn.alpha.sum()), rel=1e-3)
    assert torch.equal(rendered_flow(model, camera, 0.0, camera, 0.0)[1], drawn.alpha)


@pytest.mark.parametrize("antialiased", [False, True])
def test_the_mode_is_saved_with_the_model_and_with_a_checkpoint(views, antialiased, tmp_path):
    model = tiny(antialiased)
    assert Model.from_arrays(model.to_arrays(), model.config).antialiased is antialiased
    Trainer(model, views, [Phase("static", 20, move=False)], SETTINGS, 60, checkpoints=tmp_path).run()
    found = model_of(tmp_path)
    assert found is not None and found[0].antialiased is antialiased
