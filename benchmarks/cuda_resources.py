"""Records what the CUDA kernels use on each architecture: registers, spills, stack, shared memory.

    python benchmarks/cuda_resources.py [--out FOLDER]

Compiles every program in RECORDED of `rasterizer/cuda/programs.py` and `scene/cuda/programs.py` for sm_75, sm_80, sm_86, sm_89 and sm_90,
which takes no GPU, and writes `cuda_resources.json` into tests/rasterizer and tests/scene. `test_cuda_compiles.py` beside each holds the
kernels to it: run this after a change of a kernel whose registers are meant to rise, and commit the file with the change.
"""

from __future__ import annotations

import argparse
import json
import os
import re
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict
from pathlib import Path

from e4dgs.rasterizer.cuda.programs import ARCHITECTURES
from e4dgs.rasterizer.cuda.programs import RECORDED as RASTERIZER
from e4dgs.rasterizer.cuda.runtime import Program
from e4dgs.rasterizer.cuda.runtime.compiler import Compiled, compile_cubin, nvrtc_version
from e4dgs.scene.cuda.programs import RECORDED as SCENE

RECORDED = {"rasterizer": RASTERIZER, "scene": SCENE}
TESTS = Path(__file__).resolve().parents[1] / "tests"

Table = dict[str, dict[str, dict[str, dict[str, int]]]]


def measure(programs: dict[str, Program]) -> Table:
    """program -> kernel -> architecture -> what it uses."""
    jobs = [(name, arch) for name in programs for arch in ARCHITECTURES]

    def run(job: tuple[str, str]) -> Compiled:
        return compile_cubin(programs[job[0]], job[1])

    table: Table = {}
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        for (name, arch), compiled in zip(jobs, pool.map(run, jobs)):
            for kernel, used in compiled.resources.items():
                table.setdefault(name, {}).setdefault(kernel, {})[arch] = asdict(used)
    return table


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, default=TESTS, help="where rasterizer/ and scene/ are")
    out = parser.parse_args().out
    for folder, programs in RECORDED.items():
        write(measure(programs), out / folder / "cuda_resources.json")


def write(table: Table, file: Path) -> None:
    text = json.dumps({"nvrtc": ".".join(map(str, nvrtc_version())), "programs": table}, indent=1)
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(re.sub(r"\{\s*(\"registers\"[^}]*?)\s*\}", lambda found: "{" + re.sub(r"\s+", " ", found[1]) + "}", text) + "\n")
    spilled = [
        f"{name}, {kernel}, {arch}: {used['spill_bytes']} bytes spilled"
        for name, kernels in table.items()
        for kernel, archs in kernels.items()
        for arch, used in archs.items()
        if used["spill_bytes"]
    ]
    print("\n".join([f"{sum(map(len, table.values()))} kernels of {len(table)} programs in {file}", *spilled]))


if __name__ == "__main__":
    main()
