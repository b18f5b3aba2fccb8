"""Races that show only under some order of threads, or under none: RACES finds them in any."""

from ctypes import c_bool, c_int32

import pytest
import torch

from simt import RACES, SimtError, needs_compiler
from simt.own_kernels import SEEDS, ints, kernels_of, launch

pytestmark = needs_compiler


RACING = {
    "shuffled": r"thread 0\) reads byte 4 of kept, at races.cu:28; thread 1 wrote it, at races.cu:26,",
    "across_warps": r"thread 32\) reads byte 0 of kept, at races.cu:35; thread 0 wrote it, at races.cu:33,",
    "across_blocks": r"thread 0\) writes byte 12 of out, at races.cu:39; thread 0 of block 0 wrote it, at races.cu:39,",
    "read_of_an_atomic": r"thread 31\) reads byte 0 of out, at races.cu:44; thread 0 wrote it, at races.cu:43,",
    "part_of_a_vector": r"thread 48\) writes byte 19[2-5] of out, at races.cu:48; thread 1 wrote it, at races.cu:50,",
}


@pytest.mark.parametrize("kernel", RACING)
def test_races_are_found_in_any_order(kernel):
    out = torch.zeros(256) if kernel == "part_of_a_vector" else ints(256)
    threads = 64 if kernel in ("across_warps", "part_of_a_vector") else 32
    launch(kernels_of("races"), kernel, 2, threads, out)
    with pytest.raises(SimtError, match=f"race: .*{RACING[kernel]}"):
        launch(kernels_of("races"), kernel, 2, threads, out, flags=RACES)
    for seed in SEEDS:
        with pytest.raises(SimtError, match=r"race: .* and nothing orders the two"):
            launch(kernels_of("races"), kernel, 2, threads, out, seed=seed, flags=RACES)


@pytest.mark.parametrize("seed", SEEDS)
def test_what_is_ordered_is_no_race(seed):
    out, total, flag, marks = ints(4), ints(1), ints(1), torch.zeros(128, dtype=torch.uint8)
    launch(kernels_of("races"), "passed_on", 1, 32, c_bool(True), out, seed=seed, flags=RACES)
    assert int(out[0]) == 7
    with pytest.raises(SimtError, match="race: "):
        launch(kernels_of("races"), "passed_on", 1, 32, c_bool(False), out, seed=seed, flags=RACES)
    launch(kernels_of("races"), "added_up", 2, 64, total, flag, marks, seed=seed, flags=RACES)
    assert int(total) == 64 * 63 and int(flag) == 1 and bool(marks.all())
    launch(kernels_of("shared"), "rotate", 1, 256, c_bool(True), c_int32(3), ints(256), ints(256), seed=seed, flags=RACES)
    with pytest.raises(SimtError, match="race: "):
        launch(kernels_of("shared"), "rotate", 1, 256, c_bool(False), c_int32(3), ints(256), ints(256), seed=seed, flags=RACES)
