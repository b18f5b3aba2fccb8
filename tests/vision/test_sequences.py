"""The frames of a capture camera by camera, in order of time."""

import numpy as np
import pytest
from e4dgs.vision.sequences import camera_sequences

CAMERA = [7, 2, 7, 2, 7, 2, 10]
TIME = [0.5, 1.0, 0.0, 0.2, 0.5, 0.1, 0.3]


@pytest.mark.parametrize("frames", [None, range(7), np.arange(7)[::-1], {6, 5, 4, 3, 2, 1, 0}], ids=["none", "range", "backwards", "set"])
def test_each_camera_is_followed_through_time_and_equal_times_by_number(frames):
    sequences = camera_sequences(np.array(CAMERA, np.int32), np.array(TIME), frames)
    assert list(sequences.items()) == [(2, [5, 3, 1]), (7, [2, 0, 4]), (10, [6])]
    assert {type(i) for camera, mine in sequences.items() for i in (camera, *mine)} == {int}, "they go into JSON"


def test_only_the_frames_that_count_are_there():
    assert camera_sequences(CAMERA, TIME, np.array([4, 1, 5, 2])) == {2: [5, 1], 7: [2, 4]}
    assert camera_sequences(CAMERA, TIME, []) == {} and camera_sequences([], []) == {}
