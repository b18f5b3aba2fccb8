"""Hulls of convexes as meshes: closed, outwards, of the right volume, whatever the points; K points that need not be corners."""

import numpy as np
import pytest
import torch
import trimesh
from e4dgs.rasterizer import Convexes
from e4dgs.scene.hull_mesh import hull_mesh, hull_triangles
from scipy.spatial import ConvexHull

CUBE = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)


@pytest.mark.parametrize("corners", [4, 5, 6, 7, 8])
def test_hulls_of_random_points_are_those_of_qhull(corners):
    points = np.random.default_rng(corners).normal(size=(40, corners, 3))
    triangles = hull_triangles(points)
    owner = triangles[:, 0] // corners
    assert (triangles // corners == owner[:, None]).all()
    for k in range(40):
        made = trimesh.Trimesh(points[k], triangles[owner == k] - corners * k, process=False)
        truth = ConvexHull(points[k])
        assert made.is_watertight and made.volume == pytest.approx(truth.volume, rel=1e-9)
        assert {frozenset(t) for t in made.faces} == {frozenset(t) for t in truth.simplices}


def test_a_cube_whose_faces_have_four_points_is_closed():
    made = trimesh.Trimesh(CUBE, hull_triangles(CUBE[None]), process=False)
    assert len(made.faces) == 12 and made.is_watertight and made.volume == pytest.approx(1, abs=1e-9)


def test_a_moving_point_changes_the_triangles():
    """Why each time has triangles of its own: a corner that moves inside is none any more."""
    points = np.concatenate([CUBE[[0, 1, 2, 4]], [[0.6, 0.6, 0.6]]])[None]
    inside = points.copy()
    inside[0, 4] = 0.2
    assert 4 in hull_triangles(points) and 4 not in hull_triangles(inside)


def test_flat_and_doubled_points_break_nothing():
    flat = CUBE[[0, 1, 2, 3]][None] * [1, 1, 1]
    assert len(hull_triangles(flat)) in (2, 3, 4)
    assert len(hull_triangles(CUBE[None, :3])) == 1
    same = np.zeros((2, 6, 3))
    assert hull_triangles(same).max(initial=0) < 12


def test_the_mesh_has_each_convex_s_colour_and_opacity_and_leaves_out_what_is_not_seen():
    points = torch.tensor(np.stack([CUBE, CUBE + 3, CUBE + 6]), dtype=torch.float32)
    sh = torch.zeros(3, 4, 3)
    sh[0, 0] = torch.tensor([1.0, 0.0, -1.0])
    made = hull_mesh(Convexes(points, torch.ones(3), torch.ones(3), torch.tensor([0.7, 0.001, 0.9]), sh=sh))
    assert made.vertices.shape == (16, 3) and made.triangles.shape == (24, 3)
    np.testing.assert_allclose(made.colors[0], [0.7821, 0.5, 0.2179, 0.7], atol=1e-4)
    np.testing.assert_allclose(made.colors[-1], [0.5, 0.5, 0.5, 0.9], atol=1e-6)
    assert made.vertices[8:].min() == 6
    none = Convexes(torch.zeros(0, 6, 3), torch.zeros(0), torch.zeros(0), torch.zeros(0), sh=torch.zeros(0, 1, 3))
    assert hull_mesh(none).triangles.shape == (0, 3)
