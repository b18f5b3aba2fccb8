"""Rows of the suite field: one file a row, each with `measure`."""
