"""Rows that exist for benchmarks/results/benchmarks.md, beside those of `e4dgs bench`; `benchmarks/bench.py` measures both."""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parents[2] / "tests"))  # for rasterizer/thresholds.py, which tests need, too
