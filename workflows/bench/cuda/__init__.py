"""Rows of `e4dgs bench cuda`: one file a row, each with `measure`."""
