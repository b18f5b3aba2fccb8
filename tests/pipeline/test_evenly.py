"""A few of many: evenly spread, in their order, with both ends."""

import numpy as np
import pytest
from e4dgs.pipeline.choice.evenly import evenly


@pytest.mark.parametrize("count", [0, 1, 2, 3, 24, 25, 151])
@pytest.mark.parametrize("most", [0, 1, 2, 3, 24, 25, 1000])
def test_items_are_evenly_spread_and_none_comes_twice(count, most):
    chosen = np.array(evenly(range(count), most), int)
    assert len(chosen) == min(count, most) and chosen.tolist() == sorted(set(chosen.tolist()))
    if len(chosen) > 1:
        assert chosen[0] == 0 and chosen[-1] == count - 1 and np.ptp(np.diff(chosen)) <= 1
    elif len(chosen):
        assert chosen[0] == 0


def test_an_array_gives_rows_and_a_sequence_a_list():
    rows = np.arange(20).reshape(10, 2)
    assert evenly(rows, 3).tolist() == [[0, 1], [8, 9], [18, 19]], "4.5 is rounded to even"
    assert evenly(list("abcdefghij"), 3) == ["a", "e", "j"]
