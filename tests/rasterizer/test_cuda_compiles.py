"""Every kernel of the rasterizer compiles for every architecture of the record, without spills and within its recorded registers."""

from pathlib import Path

from e4dgs.rasterizer.cuda.programs import RECORDED
from e4dgs.rasterizer.cuda.runtime.compiler import Resources

from .cuda_record import COMMAND, complaints, every_architecture, hold, hold_names, needs_nvrtc

RECORD = Path(__file__).parent / "cuda_resources.json"


@needs_nvrtc
@every_architecture
def test_kernels_do_not_spill_nor_outgrow_their_record(request, arch):
    hold(RECORDED, RECORD, arch, request.config.getoption("--kernels"))


def test_the_record_has_no_program_that_is_gone():
    hold_names(RECORDED, RECORD)


def test_every_complaint_names_kernel_architecture_and_command():
    found = {"a.cu": {"k": Resources(40, 8, 0, 0), "fine": Resources(30, 0, 0, 0), "new": Resources(10, 0, 0, 0)}}
    recorded = {"a.cu": {"k": {"sm_80": {"registers": 32}}, "fine": {"sm_80": {"registers": 30}}}}
    assert complaints("sm_80", found, recorded, True) == [
        "k of a.cu, sm_80: 8 bytes of registers are spilled at 40 registers",
        f"k of a.cu, sm_80: 32 registers recorded, 40 found; if that is meant, run {COMMAND}",
        f"new of a.cu, sm_80: not recorded; run {COMMAND}",
    ]
    assert len(complaints("sm_80", found, recorded, False)) == 2
