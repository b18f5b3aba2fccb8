"""Rows of the suite cuda: one file a row, each with `measure`."""
