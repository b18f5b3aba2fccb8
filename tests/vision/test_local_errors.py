"""Depth that is wrong by much the same amount at neighbouring pixels is corrected by the known points around them."""

import cv2
import numpy as np
import pytest
from e4dgs.vision.depth.local_errors import FAR, REACHES, correction, errors_of, how_alike, left

SHAPE = 108, 192
FRAMES = 6


def smooth(rng, reach):
    """[h, w], normal numbers with a standard deviation of 0.05, alike within about ``reach`` of the width."""
    noise = cv2.GaussianBlur(rng.normal(size=SHAPE), (0, 0), reach * SHAPE[1])
    return 0.05 * noise / noise.std()


def known(rng, field, count=250, own=0.005):
    """The errors at ``count`` points of ``field``, with an error of each point itself."""
    y, x = rng.integers(SHAPE[0], size=count), rng.integers(SHAPE[1], size=count)
    place = (np.stack([x, y], 1) + 0.5) / SHAPE[1]
    return errors_of(place, field[y, x] + own * rng.normal(size=count))


@pytest.mark.parametrize("reach", [0.05, 0.1, 0.2])
def test_smooth_errors_go_and_what_is_left_is_told(reach):
    rng = np.random.default_rng(0)
    fields = [smooth(rng, reach) for _ in range(FRAMES)]
    errors = {i: known(rng, field) for i, field in enumerate(fields)}
    alike = how_alike(errors)
    assert alike is not None and 0.5 * reach < alike.reach < 8 * reach
    off = [field - np.log(correction(alike, errors[i], SHAPE)) for i, field in enumerate(fields)]
    before, after = np.median(np.abs(fields)), np.median(np.abs(off))
    assert after < 0.3 * before
    told = np.median([left(alike, one) for one in errors.values()])
    assert after < told < 2 * after + 0.005, "points have an error of their own"


def test_where_no_point_is_near_nothing_changes():
    rng = np.random.default_rng(1)
    field = np.full(SHAPE, 0.05)
    errors = {i: known(rng, smooth(rng, 0.03)) for i in range(FRAMES)}
    alike = how_alike(errors)
    assert alike is not None and alike.reach <= 0.12
    place = np.stack([np.linspace(0, 0.1, 50), np.linspace(0, 0.1, 50)], 1)
    found = np.log(correction(alike, errors_of(place, np.full(50, field[0, 0])), SHAPE))
    assert found[5, 5] == pytest.approx(0.05, abs=0.01) and abs(found[-1, -1]) < 1e-4


def test_errors_that_are_alike_nowhere_stay():
    rng = np.random.default_rng(2)
    assert how_alike({i: errors_of(rng.uniform(size=(200, 2)), 0.05 * rng.normal(size=200)) for i in range(FRAMES)}) is None
    assert how_alike({}) is None
    nothing = errors_of(np.zeros((0, 2)), np.zeros(0))
    assert how_alike({0: nothing}) is None
    assert how_alike({0: errors_of(rng.uniform(size=(50, 2)), np.zeros(50))}) is None, "depth that is exact"


def test_points_that_are_wrong_themselves_do_little():
    rng = np.random.default_rng(3)
    fields = [smooth(rng, 0.1) for _ in range(FRAMES)]
    errors = {}
    for i, field in enumerate(fields):
        one = known(rng, field)
        wrong = np.where(rng.uniform(size=len(one.log)) < 0.08, rng.choice([-2.0, 2.0], len(one.log)), one.log)
        errors[i] = errors_of(one.place, wrong)
        assert np.abs(errors[i].log).max() <= FAR * np.median(np.abs(wrong)) * (1 + 1e-9)
    alike = how_alike(errors)
    assert alike is not None and alike.reach in REACHES
    off = [field - np.log(correction(alike, errors[i], SHAPE)) for i, field in enumerate(fields)]
    assert np.median(np.abs(off)) < 0.5 * np.median(np.abs(fields))


def test_maps_of_any_size_are_corrected():
    rng = np.random.default_rng(4)
    errors = {i: known(rng, smooth(rng, 0.2)) for i in range(FRAMES)}
    alike = how_alike(errors)
    for shape in ((1, 1), (3, 200), (480, 270)):
        found = correction(alike, errors[0], shape)
        assert found.shape == shape and found.dtype == np.float32 and np.isfinite(found).all() and (found > 0).all()
    assert (correction(alike, errors_of(np.zeros((0, 2)), np.zeros(0)), (4, 5)) == 1).all()
