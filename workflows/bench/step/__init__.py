"""Rows of `e4dgs bench step`: one file a row, each with `measure`."""
