"""Rows that exist for benchmarks/results/benchmarks.md, beside those of `e4dgs bench`; `benchmarks/bench.py` measures both."""
