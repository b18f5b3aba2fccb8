"""Captures far from the origin."""

import numpy as np
import pytest
from e4dgs.stages.captures.far_away import FAR, told_far


def cameras(offset: float) -> np.ndarray:
    """Four turned cameras within 2 units of (offset, 0, 0)."""
    poses = np.tile(np.eye(4), (4, 1, 1))
    for pose, angle in zip(poses, np.linspace(0, 2 * np.pi, 4, endpoint=False)):
        c, s = np.cos(angle), np.sin(angle)
        pose[:3, :3] = [[c, 0, s], [0, 1, 0], [-s, 0, c]]
        pose[:3, 3] = -pose[:3, :3] @ [offset + 2 * c, 2 * s, 0.0]
    return poses


@pytest.mark.parametrize(("offset", "told"), [(0.0, False), (1.99 * FAR, False), (2.01 * FAR, True), (4e6, True)])
def test_cameras_far_from_the_origin_are_told_of(offset, told):
    note = told_far(cameras(offset))
    assert (note is not None) == told
    if note:
        assert f"({offset:.6g}," in note


def test_a_single_place_says_nothing_about_how_large_the_scene_is():
    assert told_far(cameras(1e9)[:1]) is None
