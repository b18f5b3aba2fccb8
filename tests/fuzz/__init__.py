"""Structured fuzzing of `rasterize`: `cases` makes arguments from two numbers, `invariants` says what must hold of any."""
