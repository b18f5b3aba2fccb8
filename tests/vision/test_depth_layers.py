"""Things that move and touch in the picture are told apart by the step of depth between them, and only by that."""

import cv2
import numpy as np
import pytest
from e4dgs.vision.moving.depth_layers import STEP, depth_layers
from e4dgs.vision.moving.followed_parts import inner

SHAPE = 135, 240
LEAST = 32


def layers(mask, z):
    return depth_layers(mask, inner(mask.astype(np.uint8)) > 0, z.astype(np.float32), LEAST)


def two_things(near=3.0, far=4.5):
    """A tall thing before a square one that shows on both sides of it: mask, depth, and which is which."""
    which = np.zeros(SHAPE, int)
    which[60:90, 80:170] = 2
    which[20:120, 110:140] = 1
    return which > 0, np.select([which == 1, which == 2], [near, far], 8.0), which


def test_a_thing_behind_another_gets_its_own_number_on_both_sides():
    mask, z, which = two_things()
    found = layers(mask, z)
    left, middle, right = found[75, 90], found[70, 125], found[75, 160]
    assert left != middle != right and left != right, "what shows on both sides is two parts"
    assert (found[mask] > 0).all() and (found[~mask] == 0).all()
    for part, value in (
        (which == 1, middle),
        ((which == 2) & (np.arange(240) < 110), left),
        ((which == 2) & (np.arange(240) >= 140), right),
    ):
        assert (found[part] == value).mean() > 0.93


def test_depth_that_is_blurred_and_noisy_as_a_networks_will_do():
    mask, z, which = two_things()
    rng = np.random.default_rng(0)
    noise = cv2.GaussianBlur(rng.normal(size=SHAPE), (0, 0), 20)
    z = cv2.GaussianBlur(z, (0, 0), 2) * np.exp(0.05 * noise / noise.std())
    found = layers(mask, z)
    assert len({found[75, 90], found[70, 125], found[75, 160]}) == 3 and (found[which == 1] == found[70, 125]).mean() > 0.9


@pytest.mark.parametrize(("step", "things"), [(0.8 * STEP, 1), (1.2 * STEP, 3)])
def test_steps_count_from_the_least_on(step, things):
    mask, z, _ = two_things(far=3.0 * np.exp(step))
    assert len(np.unique(layers(mask, z)[mask])) == things


def test_one_thing_stays_one():
    mask = np.zeros(SHAPE, bool)
    mask[20:120, 40:200] = True
    lying = np.broadcast_to(np.linspace(2.0, 6.0, 240), SHAPE)  # along the axis: a large difference, but no step
    assert (layers(mask, lying)[mask] == 1).all()
    assert (layers(mask, np.zeros(SHAPE))[mask] == 1).all(), "no depth is known"
    small = np.full(SHAPE, 3.0)
    small[60:65, 100:105] = 5.0
    assert (layers(mask, small)[mask] == 1).all(), "too small to be a thing"
    assert (layers(np.zeros(SHAPE, bool), lying) == 0).all()


def test_parts_that_do_not_touch_stay_apart_at_one_depth():
    mask = np.zeros(SHAPE, bool)
    mask[20:60, 20:60] = mask[80:120, 150:200] = True
    found = layers(mask, np.full(SHAPE, 4.0))
    assert sorted(np.unique(found)) == [0, 1, 2] and found[40, 40] != found[100, 170]
