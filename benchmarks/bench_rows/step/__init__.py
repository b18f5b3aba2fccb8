"""Rows of the suite step: one file a row, each with `measure`."""
