"""Rows of `e4dgs bench field`: one file a row, each with `measure`."""
