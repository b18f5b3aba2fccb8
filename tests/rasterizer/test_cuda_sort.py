"""The radix sort of the CUDA kernels, in the emulator and on a GPU, against torch's."""

import pytest
import torch
from e4dgs.rasterizer.cuda.runtime import launcher_for
from e4dgs.rasterizer.cuda.sort import ITEMS, THREADS, sort
from simt import CHECKED, RACES, Emulator
from simt.compiler import needs_compiler

BLOCK = THREADS * ITEMS
TYPES = {2: torch.int16, 4: torch.int32, 8: torch.int64}


def some_keys(width: int, count: int, most: int | None = None) -> torch.Tensor:
    g = torch.Generator().manual_seed(count)
    limit = 2 ** (8 * width - 1) if most is None else most
    return torch.randint(limit - 1 if width == 8 else limit, (count,), generator=g, dtype=torch.int64).to(TYPES[width])


def hold(launcher, keys: torch.Tensor, device: str = "cpu") -> None:
    want, order = torch.sort(keys, stable=True)
    got, values = sort(launcher, keys.to(device, copy=True))
    assert torch.equal(got.cpu(), want) and torch.equal(values.cpu().long(), order)
    given = torch.arange(len(keys), dtype=torch.int32) * 3
    none, values = sort(launcher, keys.to(device, copy=True), given.to(device, copy=True), keep_keys=False)
    assert none is None and torch.equal(values.cpu(), given[order])


@needs_compiler
@pytest.mark.parametrize("width", TYPES)
def test_sizes_around_a_block(width: int) -> None:
    for count in (0, 1, 31, 33, BLOCK - 1, BLOCK, BLOCK + 1, 3 * BLOCK + 17):
        hold(Emulator(), some_keys(width, count))


@needs_compiler
@pytest.mark.parametrize("width", TYPES)
def test_equal_keys_keep_their_order_whatever_runs_first(width: int) -> None:
    for seed in range(3):
        hold(Emulator(seed), some_keys(width, 2 * BLOCK + 5, most=7))
        hold(Emulator(seed), torch.zeros(BLOCK + 9, dtype=TYPES[width]))


@needs_compiler
@pytest.mark.parametrize("number", [0, 1, BLOCK - 1, BLOCK, BLOCK + 3, 2 * BLOCK + 9])
def test_as_many_keys_are_sorted_as_the_device_says(number: int) -> None:
    keys = some_keys(8, 2 * BLOCK + 9)
    _, values = sort(Emulator(), keys.clone(), keep_keys=False, number=torch.tensor([number]))
    assert torch.equal(values[:number].long(), torch.sort(keys[:number], stable=True).indices)


@needs_compiler
def test_the_largest_keys_are_not_taken_for_the_end() -> None:
    """Threads without a key rank with the largest digit."""
    for kind in TYPES.values():
        hold(Emulator(), torch.full((BLOCK - 7,), torch.iinfo(kind).max, dtype=kind))


@needs_compiler
def test_depths_sort_by_their_bits() -> None:
    g = torch.Generator().manual_seed(1)
    parts = [torch.rand(500, generator=g, dtype=torch.float64) * 10**k for k in range(-8, 9, 4)]
    depths = torch.cat([*parts, torch.full((3,), torch.inf, dtype=torch.float64)])
    _, order = sort(Emulator(), depths.view(torch.int64).clone(), keep_keys=False)
    assert torch.equal(order.long(), torch.sort(depths, stable=True).indices)


@needs_compiler
def test_no_access_is_out_of_bounds_and_no_two_are_unordered() -> None:
    hold(Emulator(5, flags=(*CHECKED, *RACES)), some_keys(2, BLOCK + 100))


@pytest.mark.cuda
@pytest.mark.parametrize("width", TYPES)
def test_large_sorts_on_a_gpu(width: int) -> None:
    for count in (1, BLOCK + 1, 3_000_001):
        for most in (None, 300):
            hold(launcher_for(torch.device("cuda")), some_keys(width, count, most), "cuda")
