"""Which Gaussians become convexes, and that those leave."""

import numpy as np
import pytest
import torch
from e4dgs.rasterizer import rasterize
from e4dgs.scene.model import Model
from e4dgs.scene.motion.static import Static
from e4dgs.scene.primitives import ConvexSet, GaussianSet
from e4dgs.scene.views import Views
from e4dgs.stages.fine.run import replace_by_convexes
from e4dgs.stages.hulls.artifact import StoredHulls
from e4dgs.stages.hulls.defaults import CONVEXES, most_convexes
from e4dgs.stages.hulls.edge_seeds import EdgeSeeds, edge_seeds
from e4dgs.stages.hulls.run import choose
from e4dgs.stages.hulls.settings import HullSettings


def found(error, density=1.0, weight=10.0):
    error = np.asarray(error, float)
    return EdgeSeeds(np.full_like(error, weight), np.full_like(error, density), error)


def settings(**changed):
    return HullSettings.model_validate({"share": 1.0} | changed)


def test_those_with_the_most_error_at_edges_become_convexes_in_their_order():
    assert choose(found([3, 0, 9, 1, 7]), settings(), 3).tolist() == [0, 2, 4]


@pytest.mark.parametrize(("share", "count"), [(0.0, 0), (0.199, 1), (0.2, 2), (0.5, 5)])
def test_at_most_a_share_of_the_gaussians(share, count):
    assert len(choose(found(np.arange(1, 11)), settings(share=share), 100)) == count


@pytest.mark.parametrize(("density", "weight", "count"), [(0.25, 1.01, 4), (0.249, 1.01, 0), (0.25, 1.0, 0)])
def test_only_where_edges_are_dense_and_that_is_seen(density, weight, count):
    assert len(choose(found([1, 2, 3, 4], density, weight), settings(), 100)) == count


@pytest.mark.parametrize(
    ("given", "kind", "most"), [(None, "planes", CONVEXES), (None, "nodes", 0), (0, "lifetimes", 0), (7, "static", 7), (7, "nodes", 7)]
)
def test_with_control_nodes_there_are_none_unless_asked_for(given, kind, most):
    assert most_convexes(given, kind) == most


def test_no_error_no_convexes():
    assert len(choose(found([0, 0]), settings(), 100)) == 0


def wall(edge_at: int, shown_at: int) -> tuple[Model, Views]:
    """A picture of black beside white from column ``edge_at`` on; a model of two Gaussians that shows it from ``shown_at`` on."""
    picture = np.zeros((32, 64, 3), np.uint8)
    picture[:, edge_at:] = 255
    K = np.array([[[40.0, 0, 32], [0, 40.0, 16], [0, 0, 1]]])
    views = Views(K, np.eye(4)[None], np.zeros(1), np.zeros(1, int), np.full(1, -1), np.zeros(1, int), 64, 32, lambda i: picture)
    columns = np.arange(64) + 0.5
    x, y = np.meshgrid((columns - 32) / 40 * 4, (np.arange(0, 32, 4) + 2 - 16) / 40 * 4)
    points = np.stack([x.ravel(), y.ravel(), np.full(x.size, 4.0)], 1)
    shown = np.repeat((np.broadcast_to(columns, x.shape) > shown_at).ravel()[:, None], 3, 1).astype(float)
    gaussians = GaussianSet.from_points(points, shown, 0, opacity=0.95)
    with torch.no_grad():
        gaussians.log_scales.copy_(torch.tensor([0.05, 0.25, 0.01]).log().expand(len(points), 3))
    return Model(gaussians, ConvexSet.empty(6, 0), Static(), 0), views


def test_error_counts_at_edges_alone():
    right, wrong = (edge_seeds(*wall(32, at), [0]) for at in (32, 29))
    model, _ = wall(32, 29)
    column = 32 + 10 * model.gaussians.means[:, 0].detach().numpy()
    at_the_edge = np.abs(column - 30.5) < 2
    assert wrong.error[at_the_edge].sum() > 3 * right.error[at_the_edge].sum()
    assert wrong.error[at_the_edge].sum() > 0.8 * wrong.error.sum()
    assert wrong.density[np.abs(column - 32) > 12].max() < 0.05 < wrong.density[at_the_edge].max()


def test_gaussians_that_become_convexes_leave_and_the_image_hardly_changes():
    model, views = wall(32, 32)
    camera = views.rasterizer_camera(0)
    before = rasterize(camera, *model.at(0.0))
    seeds = np.array([100, 228, 300])  # white ones
    named = model.gaussians.means.detach().numpy()
    shapes = np.zeros((3, 6, 3), np.float32)
    replace_by_convexes(model, StoredHulls(shapes, np.zeros((3, 3), np.float32), seeds.astype(np.int32), np.ones(3, np.float32), 6, ""))
    assert len(model.gaussians) == len(named) - 3 and len(model.convexes) == 3
    np.testing.assert_allclose(model.convexes.points.detach().mean(1), named[seeds], atol=0.02)
    np.testing.assert_array_equal(model.gaussians.means.detach(), np.delete(named, seeds, 0))
    after = rasterize(camera, *model.at(0.0))
    change = (after.color - before.color).detach().abs().mean(-1)
    assert 0 < float(change.mean()) < 0.001
