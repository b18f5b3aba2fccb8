"""What `coarse` chooses by itself."""

import pytest
from e4dgs.stages.coarse import auto_iterations


@pytest.mark.parametrize(
    ("frames", "times", "static", "expected"),
    [
        (81, 67, False, 6000),  # a new camera at every time
        (90, 90, False, 6000),  # one camera over time
        (372, 12, False, 6000),  # a rig over few times
        (4 * 45, 45, False, 9000),
        (4 * 45 - 1, 45, False, 6000),
        (8 * 45, 45, True, 6000),
        (20 * 300, 300, False, 30_000),
    ],
)
def test_steps_follow_the_times_that_a_rig_must_learn_one_after_another(frames, times, static, expected):
    assert auto_iterations(frames, times, static) == expected
