"""The cost of the first use: compiling all kernels that training needs with an empty cache, and a start with a full one."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from ..rows import Bench, Check, Measured
from .gpu import gpu_name, need_gpu

COMPILE_S, START_S = 20.0, 0.2
# Runs in a separate process. Importing torch and creating the GPU's context are not timed; compiling and loading our kernels is.
PROBE = """
import json, time, torch
from e4dgs.rasterizer.cuda import programs, selftest
from e4dgs.rasterizer.cuda.runtime import warm_up
from e4dgs.scene.cuda.programs import RECORDED
device = torch.device("cuda", 0)
torch.zeros(1, device=device)
torch.cuda.synchronize()
start = time.perf_counter()
needed = [*programs.needed(degree=3, extras=2), *programs.needed(points=6, degree=3, extras=2), *RECORDED.values()]
warm_up(needed, device)
print(json.dumps(time.perf_counter() - start))
"""


def measure(bench: Bench) -> Measured:
    need_gpu()
    bench.expect(2)
    with TemporaryDirectory() as folder:
        first = _seconds(Path(folder))
        bench.tick("empty cache")
        later = _seconds(Path(folder))
        bench.tick("full cache")
    return Measured(
        f"all kernels of training Gaussians and convexes of 6 points, SH of degree 3, two extras, field, loss and optimiser; {gpu_name()}",
        [Check("compiling with an empty cache", first, COMPILE_S, unit="s"), Check("a later start", later, START_S, unit="s")],
    )


def _seconds(cache: Path) -> float:
    environment = {**os.environ, "E4DGS_CACHE": str(cache)}
    done = subprocess.run([sys.executable, "-c", PROBE], capture_output=True, text=True, env=environment, timeout=600)
    if done.returncode:
        raise RuntimeError(
            f"the probe ended with {done.returncode}: {done.stderr.strip().splitlines()[-1] if done.stderr.strip() else 'no word'}"
        )
    return float(json.loads(done.stdout.splitlines()[-1]))
