"""Edges that neighbours in time confirm, and boundaries of motion."""

from itertools import pairwise

import numpy as np
import pytest
from e4dgs.scene.edges import edge_weights
from e4dgs.vision.edges import BOUNDARY, Seen, motion_boundaries, seen_by, stable_edges

FULL = np.full((40, 60), 255, np.uint8)
NOTHING = np.zeros((40, 60), np.uint8)


def split_flow(jump: float) -> np.ndarray:
    """The right half moves by `jump` px more than the left."""
    flow = np.zeros((40, 60, 2), np.float32)
    flow[:, 30:, 0] = jump
    return flow


@pytest.mark.parametrize(("jump", "weight"), [(0.0, 0), (BOUNDARY[0] - 0.1, 0), (BOUNDARY[1] + 0.3, 255), (20.0, 255)])
def test_flow_that_breaks_is_an_edge(jump, weight):
    found = motion_boundaries(split_flow(jump), FULL)
    assert found[:, 29:31].min() == found[:, 29:31].max() == weight
    assert not found[:, :24].any() and not found[:, 36:].any()


def test_a_smooth_change_of_motion_is_none_and_neither_is_a_break_that_nobody_trusts():
    ramp = np.zeros((40, 60, 2), np.float32)
    ramp[..., 1] = 0.1 * np.arange(60)
    assert not motion_boundaries(ramp, FULL).any()
    assert not motion_boundaries(split_flow(8.0), NOTHING).any()
    one_side = FULL.copy()
    one_side[:, 30:] = 0
    assert motion_boundaries(split_flow(8.0), one_side)[:, 29:31].min() == 255


def test_an_edge_that_comes_and_goes_keeps_half_and_one_that_stays_keeps_all():
    flow = np.full((40, 60, 2), [3.0, 0.0], np.float32)
    here, there = NOTHING.copy(), NOTHING.copy()
    here[:, 10], there[:, 13] = 200, 200  # stays: 3 px on
    here[:, 40] = 200  # was not there a frame later
    found = stable_edges(here, [seen_by(there, flow, FULL)])
    assert (found[:, 10] == 200).all() and (found[:, 40] == 100).all() and found[:, 41:57].max() == 0


def test_a_neighbour_counts_as_far_as_its_flow_is_trusted():
    seen = Seen(NOTHING, NOTHING, NOTHING)
    assert np.array_equal(stable_edges(FULL, [seen]), FULL) and np.array_equal(stable_edges(FULL, []), FULL)
    assert (stable_edges(FULL, [Seen(NOTHING, FULL, NOTHING), Seen(NOTHING, FULL, NOTHING)]) == 85).all()
    assert (stable_edges(NOTHING, [Seen(NOTHING, FULL, FULL)]) == 255).all()


def test_noise_flickers_less():
    """A faint edge under noise, ten frames of it: what changes from frame to frame, away from what always stays."""
    rng = np.random.default_rng(0)
    base = np.full((60, 80, 3), 100.0)
    base[:, 40:] += 18
    own = [edge_weights(np.clip(base + rng.normal(0, 3, base.shape), 0, 255).astype(np.uint8)) for _ in range(10)]
    flow, full = np.zeros((60, 80, 2), np.float32), np.full((60, 80), 255, np.uint8)
    stable = [stable_edges(own[k], [seen_by(own[j], flow, full) for j in (k - 1, k + 1) if 0 <= j < 10]) for k in range(10)]

    def flicker(frames):
        return np.mean([np.abs(a.astype(float) - b).mean() for a, b in pairwise(frames)])

    assert flicker(stable[1:-1]) < 0.6 * flicker(own[1:-1])
    assert abs(np.mean(stable) - np.mean(own)) < 0.1 * np.mean(own)
