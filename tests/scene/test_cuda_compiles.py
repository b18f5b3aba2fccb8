"""Every kernel of the scene compiles for every architecture of the record, without spills and within its recorded registers."""

from pathlib import Path

from e4dgs.scene.cuda.programs import RECORDED
from rasterizer.cuda_record import every_architecture, hold, hold_names, needs_nvrtc

RECORD = Path(__file__).parent / "cuda_resources.json"


@needs_nvrtc
@every_architecture
def test_kernels_do_not_spill_nor_outgrow_their_record(request, arch):
    hold(RECORDED, RECORD, arch, request.config.getoption("--kernels"))


def test_the_record_has_no_program_that_is_gone():
    hold_names(RECORDED, RECORD)
