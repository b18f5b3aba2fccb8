"""Rows of `e4dgs bench step`: one file per row, each with a function `measure`."""
