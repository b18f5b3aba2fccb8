"""Surfaces of moving objects before a rig of few cameras, whose visual hull is larger than they are."""

import cv2
import numpy as np
import pytest
from e4dgs.scene.seeds.moving.hull import VisualHull
from e4dgs.scene.seeds.moving.surfaces import TOLERANCE, surface_points
from rendered_room import rendered_room


@pytest.fixture(scope="module")
def rig():
    """Views of five cameras in a room, their pictures, where each shows the box and the ball, and how far away everything is."""
    views, pictures, truths = rendered_room(5)
    backdrop = np.bincount(np.concatenate([truth.object.ravel() + 1 for truth in truths])).argmax() - 1
    return views, pictures, [truth.object != backdrop for truth in truths], [truth.depth for truth in truths]


def empty(views, depths, points, margin):
    """[n] bool: points that some camera sees past, by the true depth, and not only at the rim of an object."""
    found = np.zeros(len(points), bool)
    for i, depth in enumerate(depths):
        shown, x, y, z = views.project(i, points)
        found[shown] |= z < (1 - margin) * cv2.erode(depth, np.ones((5, 5)))[y, x]
    return found


def test_measured_points_lie_on_the_surface_and_the_rest_of_the_hull_is_not_known_to_be_empty(rig):
    views, pictures, masks, depths = rig
    hull = VisualHull(views).points(masks, views.train, 6000, 0)
    points, colors, left = surface_points(views, list(views.train), pictures, masks, hull)
    assert len(points) > 0.2 * sum(mask.sum() for mask in masks)
    assert empty(views, depths, points, TOLERANCE).mean() < 0.05
    behind = np.ones(len(points), bool)
    for i, depth in enumerate(depths):
        shown, x, y, z = views.project(i, points)
        behind[shown] &= z > (1 + TOLERANCE) * depth[y, x]
    assert behind.mean() < 0.03
    outside = empty(views, depths, hull, 0.05)
    assert outside.sum() > 500 and (outside & left).sum() < 0.6 * outside.sum()
    assert len(colors) == len(points) and colors.min() >= 0 and colors.max() <= 1
    shown, x, y, z = views.project(0, points)
    near = np.abs(z / depths[0][y, x] - 1) < 0.005
    assert np.median(np.abs(colors[shown][near] - pictures[0][y, x][near] / 255)) < 0.05


def test_without_texture_the_hull_stays_as_it_is_seen_from_outside(rig):
    views, pictures, masks, _ = rig
    hull = VisualHull(views).points(masks, views.train, 3000, 0)
    points, colors, left = surface_points(views, list(views.train), [np.full_like(p, 128) for p in pictures], masks, hull)
    assert points.shape == (0, 3) and colors.shape == (0, 3)
    assert left.mean() > 0.3


def test_nothing_is_found_of_what_no_mask_shows(rig):
    views, pictures, masks, _ = rig
    hull = VisualHull(views).points(masks, views.train, 3000, 0)
    points, colors, left = surface_points(views, list(views.train), pictures, [np.zeros_like(m) for m in masks], hull)
    assert points.shape == (0, 3) and colors.shape == (0, 3) and left.dtype == bool
