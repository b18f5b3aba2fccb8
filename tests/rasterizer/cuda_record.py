"""What CUDA kernels use on each architecture, held against a record: registers, and that nothing is spilled. No GPU is needed.

Registers decide how many blocks are on a multiprocessor at a time, and spills go to memory: neither shows in a result, both in its time.
"""

import json
import os
import warnings
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from e4dgs.rasterizer.cuda.programs import ARCHITECTURES
from e4dgs.rasterizer.cuda.runtime import Program
from e4dgs.rasterizer.cuda.runtime.compiler import Resources, compile_cubin, load_nvrtc, nvrtc_version

NOT_ALWAYS = ("sm_75", "sm_86", "sm_89")
COMMAND = "python benchmarks/cuda_resources.py"

try:
    load_nvrtc()
    missing = ""
except RuntimeError as reason:
    missing = str(reason)

needs_nvrtc = pytest.mark.skipif(bool(missing), reason=missing)
every_architecture = pytest.mark.parametrize("arch", ARCHITECTURES)


def hold(programs: Mapping[str, Program], record: Path, arch: str, kernels: str) -> None:
    """Compiles ``programs`` for ``arch`` and fails where they spill or take more than the JSON file ``record`` says. kernels: the option
    `--kernels` of the tests."""
    if arch in NOT_ALWAYS and kernels == "cpu":
        pytest.skip(f"{arch} is compiled with --kernels=cuda, as CI does; others always are")
    recorded = json.loads(record.read_text())
    version = ".".join(map(str, nvrtc_version()))
    same = version == recorded["nvrtc"]
    if not same:
        warnings.warn(f"recorded with NVRTC {recorded['nvrtc']}, this is {version}: only spills are compared, not registers", stacklevel=1)
    with ThreadPoolExecutor(os.cpu_count()) as pool:  # NVRTC runs beside itself, without the GIL
        compiled = pool.map(lambda program: compile_cubin(program, arch), programs.values())
        found = {name: code.resources for name, code in zip(programs, compiled)}
    assert all(found.values()), f"without kernels: {[name for name in found if not found[name]]}"
    lines = complaints(arch, found, recorded["programs"], compare_registers=same)
    assert not lines, "\n".join(lines)


def hold_names(programs: Mapping[str, Program], record: Path) -> None:
    """The record has these programs and no others."""
    assert json.loads(record.read_text())["programs"].keys() == programs.keys(), f"run {COMMAND}"


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
