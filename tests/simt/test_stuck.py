"""What the emulator says of kernels that are wrong: deadlock, divergence, faults of the processor. The next launch works."""

import platform
from ctypes import c_int32

import pytest
import torch

from simt import CHECKED, SimtError, needs_compiler
from simt.own_kernels import SEEDS, ints, kernels_of, launch

pytestmark = needs_compiler


STUCK = {
    "different_kinds": ["warp 0", r"lanes 0-15: __shfl_sync at stuck.cu:6, mask 0xffffffff; lanes 16-31: __ballot_sync at stuck.cu:8"],
    "different_masks": ["warp 0", r"lane 0: __shfl_sync at stuck.cu:11, mask 0x00000021; lanes 1-31: .* mask 0xffffffff"],
    "different_places": ["warp 0", r"lanes 0-6,8-31: __syncwarp at stuck.cu:17, mask 0xffffffff; lane 7: __syncwarp at stuck.cu:15"],
    "one_has_ended": ["warp 0", r"lanes 0-2,4-31: __shfl_xor_sync at stuck.cu:22, mask 0xffffffff; lane 3: ended"],
    "one_is_at_the_barrier": ["warp 1", r"lanes 0-7,9-31: __syncwarp at stuck.cu:27, .*; lane 8: __syncthreads at stuck.cu:26"],
    "half_a_block": ["part of the block", r"warp 0 .*: lanes 0-31: __syncthreads at stuck.cu:32; warp 1 .*: lanes 0-31: .*stuck.cu:34"],
    "not_in_its_mask": ["lane 16", r"\(thread 16\) is not in the mask it gives, at stuck.cu:37"],
}


@pytest.mark.parametrize("kernel", STUCK)
def test_who_waits_for_whom_in_vain_is_named(kernel):
    who, where = STUCK[kernel]
    out = ints(64)
    with pytest.raises(SimtError, match=rf"stuck\.cu: {kernel}: block 0, .*{who}.*{where}"):
        launch(kernels_of("stuck"), kernel, 2, 64, out)
    launch(kernels_of("stuck"), "fine", 1, 64, out)  # and nothing is left of it
    assert out.tolist() == [5] * 32 + [37] * 32
    for seed in SEEDS:
        with pytest.raises(SimtError, match=f"{kernel}: block [01], "):
            launch(kernels_of("stuck"), kernel, 2, 64, out, seed=seed)


def test_a_full_mask_in_half_a_warp_is_an_error():
    with pytest.raises(SimtError, match=r"lanes 8-31: not there"):
        launch(kernels_of("stuck"), "fine", 1, 40, ints(64))


def test_faults_end_the_launch_and_not_the_process():
    out, program = ints(64), kernels_of("faults")

    def said(kernel: str, *arguments: object, **options: object) -> str:
        with pytest.raises(SimtError, match=r"block 0, warp 1: lane 8 \(thread 40\) ") as caught:
            launch(program, kernel, 1, 64, *arguments, **options)
        return str(caught.value).partition("(thread 40) ")[2]

    assert said("read_nothing", None, out) == "reads or writes at 0x1c, where nothing is, at faults.cu:13"
    if platform.machine() == "x86_64":  # others give 0
        assert said("divide", c_int32(0), out) == "divides an integer by zero, at faults.cu:17"
    assert said("never_end", out, seconds=0.05) == "has run for too long, at faults.cu:22"
    assert "where nothing is, at faults.cu" in said("use_up_the_stack", out)
    launch(program, "divide", 1, 64, c_int32(2), out)
    assert int(out[0]) == 3


def test_the_compiler_can_check_more():
    with pytest.raises(SimtError, match=r"lane 31 \(thread 63\) traps, or breaks a rule that the compiler checks, at faults.cu:31"):
        launch(kernels_of("faults"), "go_out_of_bounds", 1, 64, c_int32(1), ints(64), flags=CHECKED)
    with pytest.raises(SimtError, match=r"traps, or breaks a rule that the compiler checks, at faults.cu:37"):
        launch(kernels_of("faults"), "write_misaligned", 1, 64, torch.zeros(8), flags=CHECKED)
    launch(kernels_of("faults"), "go_out_of_bounds", 1, 64, c_int32(0), ints(64), flags=CHECKED)
