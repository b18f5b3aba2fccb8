"""Rows that exist for the tables of docs/benchmarks.md, beside those of `e4dgs bench`; `benchmarks/bench.py` measures both."""
