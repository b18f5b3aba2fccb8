"""Peak memory of one large image with gradients, and what becomes of a scene that cannot fit."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

from e4dgs.workflows.bench.rows import Bench, Check, Measured

COUNT, WIDTH, HEIGHT, SIZE = 1_000_000, 1920, 1080, 0.005
BAR = 4.0  # GiB
TOO_LARGE = 8.0  # world units: every Gaussian covers the whole image
BENCHMARKS = Path(__file__).resolve().parents[2]
LIMIT = 6.0  # GiB that the scene which is too large may take


def measure(bench: Bench) -> Measured:
    width, height = bench.size(WIDTH, HEIGHT)
    n = bench.count(COUNT, 100)
    bench.expect(2)
    fits = probe(n, width, height, SIZE)
    bench.tick("a million Gaussians")
    refused = probe(COUNT, WIDTH, HEIGHT, TOO_LARGE, LIMIT) if bench.scale == 1 else None
    bench.tick("too large")
    checks = [
        Check("growth of the resident memory", fits["growth_gib"], BAR, unit="GiB", note=f"{fits['seconds']:.1f} s; {_outcome(fits)}")
    ]
    if refused is not None:
        clear = refused["error"] == "MemoryError" and all(word in refused["message"] for word in ("primitives", "pairs", "GiB"))
        note = f"after {refused['seconds']:.1f} s and {refused['growth_gib']:.2f} GiB; {_outcome(refused)}"
        checks.append(
            Check("what cannot fit is refused with a message that names its size", float(clear), 1.0, "above", unit="", note=note)
        )
    return Measured(
        protocol=f"{n:,} Gaussians with SH of degree 3, {width}x{height}, forward + backward in a process of its own; growth from the "
        "scene to the peak",
        checks=checks,
        numbers={"fits": fits, "too_large": refused},
    )


def probe(n: int, width: int, height: int, size: float, limit: float | None = None) -> dict[str, Any]:
    """What `memory_probe` found. A process that was killed is an outcome, not an error of the benchmark."""
    command = [
        sys.executable,
        "-m",
        "bench_rows.raster.memory_probe",
        *map(str, (n, width, height, size)),
        *([] if limit is None else [str(limit)]),
    ]
    done = subprocess.run(command, capture_output=True, text=True, cwd=BENCHMARKS)
    if done.returncode:
        reason = done.stderr.strip().splitlines()[-1] if done.stderr.strip() else "no message"
        nothing = float("nan")
        return {"error": f"exit code {done.returncode}", "message": reason, "growth_gib": nothing, "seconds": nothing}
    return json.loads(done.stdout.splitlines()[-1])


def _outcome(found: dict[str, Any]) -> str:
    return f"{found['error']}: {found['message']}" if found["error"] else "rendered"
