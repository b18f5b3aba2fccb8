"""Every CUDA kernel compiles for every architecture of the record, without spills and within its recorded registers. No GPU is needed.

Registers decide how many blocks are on a multiprocessor at a time, and spills go to memory: neither shows in a result, both in its time.
"""

import json
import os
import warnings
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from e4dgs.rasterizer.cuda.compiler import Resources, compile_cubin, load_nvrtc, nvrtc_version
from e4dgs.rasterizer.cuda.programs import ARCHITECTURES
from e4dgs.rasterizer.cuda.programs import RECORDED as RASTERIZER
from e4dgs.scene.cuda.programs import RECORDED as SCENE

RECORDED = {**RASTERIZER, **SCENE}
BETWEEN = ("sm_86", "sm_89")
RECORD = Path(__file__).parent / "cuda_resources.json"
COMMAND = "python benchmarks/cuda_resources.py"

try:
    load_nvrtc()
except RuntimeError as reason:
    pytest.skip(str(reason), allow_module_level=True)


def complaints(arch: str, found: dict[str, dict[str, Resources]], recorded: dict[str, dict], compare_registers: bool) -> list[str]:
    """One line for each kernel that spills, takes more registers than recorded, or is not in the record."""
    lines = []
    for name, kernels in found.items():
        for kernel, used in kernels.items():
            known = recorded.get(name, {}).get(kernel, {}).get(arch)
            where = f"{kernel} of {name}, {arch}"
            if used.spill_bytes:
                lines.append(f"{where}: {used.spill_bytes} bytes of registers are spilled at {used.registers} registers")
            if known is None:
                lines.append(f"{where}: not recorded; run {COMMAND}")
            elif compare_registers and used.registers > known["registers"]:
                lines.append(f"{where}: {known['registers']} registers recorded, {used.registers} found; if that is meant, run {COMMAND}")
    return lines


@pytest.mark.parametrize("arch", ARCHITECTURES)
def test_kernels_do_not_spill_nor_outgrow_their_record(request, arch):
    if arch in BETWEEN and request.config.getoption("--kernels") == "cpu":
        pytest.skip(f"{arch} is compiled with --kernels=cuda, as CI does; its neighbours always are")
    record = json.loads(RECORD.read_text())
    version = ".".join(map(str, nvrtc_version()))
    same = version == record["nvrtc"]
    if not same:
        warnings.warn(f"recorded with NVRTC {record['nvrtc']}, this is {version}: only spills are compared, not registers", stacklevel=1)
    with ThreadPoolExecutor(os.cpu_count()) as pool:  # NVRTC runs beside itself, without the GIL
        compiled = pool.map(lambda program: compile_cubin(program, arch), RECORDED.values())
        found = {name: code.resources for name, code in zip(RECORDED, compiled)}
    assert all(found.values()), f"without kernels: {[name for name in found if not found[name]]}"
    lines = complaints(arch, found, record["programs"], compare_registers=same)
    assert not lines, "\n".join(lines)


def test_the_record_has_no_program_that_is_gone():
    assert json.loads(RECORD.read_text())["programs"].keys() == RECORDED.keys(), f"run {COMMAND}"


def test_every_complaint_names_kernel_architecture_and_command():
    found = {"a.cu": {"k": Resources(40, 8, 0, 0), "fine": Resources(30, 0, 0, 0), "new": Resources(10, 0, 0, 0)}}
    recorded = {"a.cu": {"k": {"sm_80": {"registers": 32}}, "fine": {"sm_80": {"registers": 30}}}}
    assert complaints("sm_80", found, recorded, True) == [
        "k of a.cu, sm_80: 8 bytes of registers are spilled at 40 registers",
        f"k of a.cu, sm_80: 32 registers recorded, 40 found; if that is meant, run {COMMAND}",
        f"new of a.cu, sm_80: not recorded; run {COMMAND}",
    ]
    assert len(complaints("sm_80", found, recorded, False)) == 2
