"""What kernels compute under the emulator, in any order of threads."""

from ctypes import c_bool, c_int32

import numpy as np
import pytest
import torch

from simt import needs_compiler
from simt.own_kernels import SEEDS, ints, kernels_of, launch

pytestmark = needs_compiler


@pytest.mark.parametrize("seed", SEEDS)
def test_a_blocks_sum_is_numpys(seed):
    x = torch.arange(1000.0)
    sums = torch.zeros(4)
    launch(kernels_of("block_sum"), "block_sum", 4, 256, x, c_int32(1000), sums, seed=seed)
    parts = np.pad(x.numpy(), (0, 24)).reshape(4, 256)
    np.testing.assert_array_equal(sums, parts.sum(1))


@pytest.mark.parametrize("flags", [(), ("-DSIMT_UCONTEXT",)], ids=["own switch", "ucontext"])
def test_lanes_exchange_numbers(flags):
    out = torch.zeros(5, 32, dtype=torch.float64)
    launch(kernels_of("lanes"), "exchange", 1, 32, c_int32(3), out, flags=flags)
    lane = np.arange(32)
    np.testing.assert_array_equal(out[0], 100 + (lane + 3) % 32)
    np.testing.assert_array_equal(out[1], 100 + np.where(lane < 3, lane, lane - 3))
    np.testing.assert_array_equal(out[2], 100 + np.where(lane > 28, lane, lane + 3))
    np.testing.assert_array_equal(out[3], 100 + (lane ^ 3))
    np.testing.assert_array_equal(out[4], np.full(32, 103))


@pytest.mark.parametrize("seed", SEEDS)
def test_lanes_agree(seed):
    x = np.arange(32) * 7 % 5
    out = ints(6, 32)
    launch(kernels_of("lanes"), "agree", 1, 32, torch.from_numpy(x.astype(np.int32)), out, seed=seed)
    out = out.numpy().view(np.uint32)
    np.testing.assert_array_equal(out[0], sum(1 << i for i in range(32) if x[i] > 2))
    np.testing.assert_array_equal(out[1], [sum(1 << i for i in range(32) if x[i] == mine) for mine in x])
    np.testing.assert_array_equal(out[2], 1)
    np.testing.assert_array_equal(out[3], 0)
    np.testing.assert_array_equal(out[4, :8], 0b10101010)
    np.testing.assert_array_equal(out[5, :8], [4, 5, 6, 7, *[2**32 - 1] * 4])  # lanes 8 to 11 were not asked: all bits set


def test_barriers_count():
    x = (torch.arange(96) % 3 == 0).int()
    out = ints(3, 96)
    launch(kernels_of("lanes"), "count", 1, 96, x, out)
    assert out.tolist() == [[32] * 96, [1] * 96, [0] * 96]
    launch(kernels_of("lanes"), "count", 1, 40, torch.ones(40, dtype=torch.int32), out)
    assert out.flatten()[:120].tolist() == [40] * 40 + [1] * 80


@pytest.mark.parametrize("seed", SEEDS)
def test_atomics_lose_nothing(seed):
    n = 1000
    x = torch.randint(1, 10**6, (n,), generator=torch.Generator().manual_seed(seed), dtype=torch.int32)
    total, low, high, length = ints(1), ints(1, fill=2**31 - 1), ints(1), ints(1)
    reals, big = (torch.zeros(1), torch.zeros(1, dtype=torch.float64)), torch.zeros(1, dtype=torch.int64)
    histogram, listed = ints(8), ints(n)
    launch(kernels_of("lanes"), "gather", 16, 64, c_int32(n), x, total, *reals, big, low, high, histogram, length, listed, seed=seed)
    assert int(total) == int(x.sum()) and float(reals[0]) == n and float(reals[1]) == 0.5 * int(x.sum()) and int(big) == n << 33
    assert int(low) == int(x.min()) and int(high) == int(x.max()) and int(length) == n
    np.testing.assert_array_equal(histogram, np.bincount(x.numpy() % 8, minlength=8))
    assert sorted(listed.tolist()) == sorted(x.tolist())
    assert (listed.tolist() == x.tolist()) == (seed == 0)  # in the order of threads, which a seed changes


def test_shared_memory_that_nobody_wrote_is_nan():
    for _ in range(2):
        out = torch.zeros(3, 64)
        launch(kernels_of("shared"), "unwritten", 3, 64, out)
        assert bool(out.isnan().all())


def test_a_missing_barrier_shows_under_some_seed():
    x, program = torch.randperm(256, generator=torch.Generator().manual_seed(0)).int(), kernels_of("shared")

    def rotated(barriers: bool, seed: int) -> list[int]:
        out = ints(256)
        launch(program, "rotate", 1, 256, c_bool(barriers), c_int32(5), x, out, seed=seed)
        return out.tolist()

    assert all(rotated(True, seed) == x.roll(-5).tolist() for seed in SEEDS)
    without = [rotated(False, seed) for seed in SEEDS]
    assert all(got != x.roll(-5).tolist() for got in without)
    assert without[1] != without[2]


def test_a_seed_is_an_order():
    def order(seed: int) -> list[int]:
        length, found = ints(1), ints(600)
        launch(kernels_of("shared"), "line_up", 3, 100, length, found, seed=seed)
        return found.tolist()

    assert order(0) == [*range(100), *range(100), *range(100, 200), *range(100, 200), *range(200, 300), *range(200, 300)]
    assert len({tuple(order(seed)) for seed in SEEDS}) == len(SEEDS)
    for seed in SEEDS:
        assert order(seed) == order(seed) and sorted(order(seed)) == sorted([*range(300), *range(300)])


@pytest.mark.parametrize("seed", SEEDS)
def test_threads_may_leave_before_a_barrier(seed):
    out = ints(256)
    launch(kernels_of("shared"), "sum_of_some", 1, 256, c_int32(100), torch.arange(256).int(), out, seed=seed)
    assert out[:100].unique().tolist() == [4950] and out[100:].unique().tolist() == [0]
