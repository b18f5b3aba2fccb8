"""The order in which training sees the times of a capture."""

import numpy as np
import pytest
from e4dgs.scene.training.curriculum import FRONT, MIN_CAMERAS, Curriculum


def rig(cameras=5, times=9, first=100, last=500, seed=3):
    train = np.arange(cameras * times)
    return Curriculum(train, np.repeat(np.linspace(0, 1, times), cameras), seed, first, last)


def test_a_rig_begins_at_its_middle_time_and_ends_with_all_of_them():
    order = rig()
    assert {order.frame(step) // 5 for step in range(100)} == {4}
    assert {order.frame(step) // 5 for step in range(500, 545)} == set(range(9))
    assert order.complete(500) and not order.complete(499)


def test_the_window_opens_one_time_after_another_and_looks_most_at_what_is_new():
    order = rig()
    assert [order.window(step) for step in (0, 100, 101, 200, 201, 300, 400, 500, 9999)] == [0, 0, 1, 1, 2, 2, 3, 4, 4]
    away = np.abs(np.array([order.frame(step) // 5 for step in range(401, 500)]) - 4)
    assert away.max() == 4 and (away > 4 - FRONT).mean() > 0.6 and (away == 0).any()
    assert all(abs(i // 5 - 4) <= 1 for i in order.probe(150, 99)) and len(order.probe(150, 99)) == 15


@pytest.mark.parametrize("cameras", [1, MIN_CAMERAS - 1])
def test_few_cameras_see_all_times_from_the_start_in_shuffled_rounds(cameras):
    order = rig(cameras)
    assert order.complete(0)
    assert sorted(order.frame(step) for step in range(cameras * 9)) == list(range(cameras * 9))


def test_enough_cameras_open_a_window_and_zero_steps_do_not():
    assert rig(MIN_CAMERAS).opens
    assert not rig(MIN_CAMERAS, last=100).opens and not rig(MIN_CAMERAS, times=1).opens


def test_the_order_depends_on_seed_and_step_alone():
    a, b, other = rig(), rig(), rig(seed=4)
    steps = [450, 3, 700, 201]
    assert [a.frame(s) for s in steps] == [b.frame(s) for s in reversed(steps)][::-1]
    assert [a.frame(s) for s in range(520)] != [other.frame(s) for s in range(520)]


def test_one_camera_a_time_may_start_from_a_window_of_times():
    order = Curriculum(np.arange(101), np.linspace(0, 1, 101), 0, 50, 450, start=4)
    assert order.opens and order.window(0) == order.window(50) == 4 and order.window(450) == 50
    assert {order.frame(step) for step in range(50)} == set(range(46, 55))
    assert not Curriculum(np.arange(101), np.linspace(0, 1, 101), 0, 50, 450, start=1).opens  # three frames show too little


@pytest.mark.parametrize(("cameras", "start", "several"), [(4, 0, True), (3, 0, False), (1, 3, False)])
def test_one_time_alone_tells_whether_cameras_see_it_from_several_sides(cameras, start, several):
    """A wide first window of a single camera holds as many frames, and yet no two of one time."""
    times = np.tile(np.linspace(0, 1, 9), cameras)
    assert Curriculum(np.arange(len(times)), times, 0, 10, 100, start).several is several
