"""Rows of `e4dgs bench cuda`: one file per row, each with a function `measure`."""
